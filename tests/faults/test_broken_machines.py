"""``plp doctor`` on machines where packages, drivers or libraries are broken: a row each, never a traceback."""

from __future__ import annotations

import json
import re
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command import ROOT, Answer, plp

from datamodules.errors import UserError
from plp_lightning.cli import doctor
from plp_lightning.envs.rendering import speed
from plp_lightning.envs.rendering.backend import Backend
from plp_lightning.runs import gpus as module

NO_GPU = {"usable": [], "present": [], "cuda": None, "reason": ""}
H100 = [{"name": "NVIDIA H100", "memory_gib": 79.6}]
ALARM = """
import signal, sys, time
import plp_lightning.envs.rendering.speed as speed
speed.LIMIT, speed._draw = 1, lambda *_: time.sleep(60)
speed._measured("egl", 1.0)
"""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "frames_per_second", lambda backend: 500.0)
    monkeypatch.setattr(doctor, "gpus", lambda: NO_GPU)
    monkeypatch.setenv("COLUMNS", "200")


def findings() -> dict[str, Any]:
    answer = plp("doctor", "--json")
    assert (answer.code, answer.err) == (0, "")
    found: dict[str, Any] = json.loads(answer.out)
    return found


@pytest.mark.parametrize("broken", [RuntimeError("[/red]"), ImportError("libOSMesa"), KeyError("x"), UserError("no")])
@pytest.mark.parametrize("probe", ["frames_per_second", "versions", "gpus"])
@pytest.mark.usefixtures("quick")
def test_a_probe_that_fails_is_a_row(probe: str, broken: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise broken

    monkeypatch.setattr(doctor, probe, fail)
    answer: Answer = plp("doctor")
    assert (answer.code, answer.err) == (0, "")
    assert str(broken.args[0]) in answer.out
    assert str(broken.args[0]) in json.dumps(findings())


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (AttributeError("'NoneType' object has no attribute 'glGetError'"), "libosmesa6 .*glGetError"),
        (ImportError("cannot find\nthe library"), "libosmesa6 .*cannot find the library"),
        (ModuleNotFoundError("No module named 'mujoco'"), "No module named 'mujoco'; .*pip install"),
    ],
)
def test_a_renderer_that_raises_says_what_to_install(
    error: Exception, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(backend: Backend, seconds: float) -> float:
        raise error

    monkeypatch.setattr(speed, "_draw", draw)
    monkeypatch.setattr(speed.signal, "alarm", lambda seconds: 0)
    assert re.search(told, str(speed._measured("osmesa", 1.0)))


def test_a_renderer_that_hangs_is_ended() -> None:
    done = subprocess.run([sys.executable, "-c", ALARM], cwd=ROOT, timeout=50, check=False)
    assert done.returncode < 0


def test_the_doctor_needs_none_of_the_packages_that_may_be_broken() -> None:
    names = ("torch", "mujoco", "robosuite", "lightning", "metaworld", "numba", "h5py", "OpenGL", "gymnasium")
    blocked = f"import sys; sys.modules.update(dict.fromkeys({names}))\n"
    code = (
        f"{blocked}from plp_lightning.cli import doctor\n"
        "doctor.frames_per_second = lambda backend: 1.0\n"
        "doctor.gpus = lambda: {'usable': [], 'present': [], 'cuda': None, 'reason': ''}\n"
        "doctor.run_doctor(['--json'])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["gpus"]["usable"] == []


def driver(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that NVIDIA's driver answers so."""
    tool = folder / "nvidia-smi"
    tool.write_text(f"#!/bin/sh\n{script}\n")
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(module, "DRIVER", [str(tool)])
    monkeypatch.setattr(module, "BUS", folder / "bus")


def torch_says(monkeypatch: pytest.MonkeyPatch, cuda: str | None, devices: list[Any], warning: str = "") -> None:
    told = {"cuda": cuda, "devices": devices, "warning": warning or None}
    monkeypatch.setattr(module, "TORCH", f"print({json.dumps(json.dumps(told))})")


def test_gpus_have_names_and_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver(tmp_path, "echo 'NVIDIA H100, 81559'", monkeypatch)
    torch_says(monkeypatch, "12.8", H100)
    assert module.gpus() == {"usable": H100, "present": H100, "cuda": "12.8", "reason": ""}
    monkeypatch.setattr(doctor, "frames_per_second", lambda backend: 500.0)
    assert "GPUs: NVIDIA H100, 79.6 GiB (torch has CUDA 12.8)" in plp("doctor").out


@pytest.mark.parametrize(
    ("script", "cuda", "warning", "reason"),
    [
        ("echo 'NVIDIA H100, 81559'", None, "", "torch is built without CUDA"),
        ("echo 'NVIDIA H100, 81559'", "13.0", "The NVIDIA driver is too old", "driver is too old"),
        ("echo 'NVIDIA H100, [N/A]'", "13.0", "", "CUDA_VISIBLE_DEVICES is ''"),
        ("echo 'Failed to initialize NVML'; exit 18", "13.0", "", "does not answer .*NVML"),
        ("exit 9", "13.0", "", "does not answer .*exit code 9"),
    ],
)
def test_a_gpu_that_torch_cannot_use_gets_a_hint(
    script: str, cuda: str | None, warning: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver(tmp_path, script, monkeypatch)
    torch_says(monkeypatch, cuda, [], warning)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    card = tmp_path / "bus" / "0000:01:00.0"
    card.mkdir(parents=True)
    (card / "vendor").write_text("0x10de\n")
    (card / "class").write_text("0x030200\n")
    found = module.gpus()
    assert len(found["present"]) == 1
    assert re.search(reason, found["reason"])
    monkeypatch.setattr(doctor, "frames_per_second", lambda backend: 500.0)
    assert any("torch cannot use it" in line for line in findings()["advice"])


@pytest.mark.parametrize("script", ["exit 9", "echo"])
def test_no_gpu_is_no_fault(script: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver(tmp_path, script, monkeypatch)
    torch_says(monkeypatch, None, [])
    assert module.gpus() == NO_GPU


@pytest.mark.parametrize("code", ["import no_torch_here", "import os; os.kill(os.getpid(), 11)", "raise SystemExit(3)"])
def test_a_torch_that_does_not_work_is_told(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver(tmp_path, "exit 9", monkeypatch)
    monkeypatch.setattr(module, "TORCH", code)
    monkeypatch.setattr(doctor, "frames_per_second", lambda backend: 500.0)
    assert "torch does not work (" in findings()["gpus"]["error"]
    assert "GPUs: none (torch does not work (" in plp("doctor").out.replace("\n", " ")


def test_torch_answers_what_it_is_asked() -> None:
    assert {*module._asked_torch()} == {"cuda", "devices", "warning"}
