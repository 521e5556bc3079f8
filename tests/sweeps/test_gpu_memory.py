"""A GPU gets no further run that its memory has no room for, as far as the driver tells."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from test_local import shell, work_at

from plp_lightning.sweeps import gpu_memory
from plp_lightning.sweeps.gpu_memory import GpuMemory

FREE = "0, GPU-aa1, 60000, 20000\n1, GPU-bb2, 100, 79900\n"
OURS = f"GPU-aa1, {os.getpid()}, 15000\nGPU-aa1, 1, 30000\nGPU-bb2, 1, 79000\n"
HERE = [os.getpid()]
__all__ = ["shell"]


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of what a driver tells: files ``gpus`` and ``processes``."""
    program = tmp_path / "nvidia-smi"
    program.write_text(
        f"#!/bin/sh\necho >> {tmp_path}/asked\n"
        f'case "$*" in *query-gpu*) cat {tmp_path}/gpus;; *) cat {tmp_path}/processes;; esac\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "gpus").write_text(FREE)
    (tmp_path / "processes").write_text(OURS)
    return tmp_path


CASES = {
    "as much free as the largest of ours holds": (OURS, "0", HERE, True),
    "less free": (OURS.replace("15000", "20001"), "0", HERE, False),
    "less free, by UUID": (OURS.replace("15000", "20001"), "GPU-aa1", HERE, False),
    "less free, by the beginning of a UUID": (OURS.replace("15000", "20001"), "GPU-aa", HERE, False),
    "another GPU": (OURS.replace("15000", "20001"), "1", HERE, True),
    "numbers that are not ours: a share of all": (OURS, "0", [-1, -2], False),
    "three shares": ("", "0", [-1, -2, -3], True),
    "amounts that are not available": (OURS.replace("15000", "[N/A]"), "0", HERE, False),
    "part of a GPU, which nobody tells of": (OURS, "MIG-1", HERE, True),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_free_is_compared_with_what_the_largest_holds(driver: Path, case: str) -> None:
    processes, gpu, running, expected = CASES[case]
    (driver / "processes").write_text(processes)
    assert GpuMemory().has_room(gpu, running) is expected


@pytest.mark.parametrize("told", ["", "nonsense\n", "0, GPU-aa1, [N/A], [N/A]\n", "exit"])
def test_a_driver_that_tells_nothing_refuses_nothing(driver: Path, told: str) -> None:
    (driver / "gpus").write_text(told)
    if told == "exit":
        (driver / "nvidia-smi").write_text("#!/bin/sh\nexit 9\n")
    assert GpuMemory().has_room("0", [-1])


def test_an_answer_stands_for_a_while(driver: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = GpuMemory()
    assert not any(memory.has_room("0", [-1]) for _ in range(5))
    assert len((driver / "asked").read_text()) == 2
    monkeypatch.setattr(gpu_memory, "STANDS", 0.0)
    (driver / "gpus").write_text(FREE.replace("20000", "60000"))
    assert memory.has_room("0", [-1])


@pytest.mark.usefixtures("shell")
def test_a_sweep_fills_the_gpu_that_has_room(driver: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu_memory, "STANDS", 0.0)
    lone = f"mkdir {driver}/$CUDA_VISIBLE_DEVICES && sleep 0.6 && rmdir {driver}/$CUDA_VISIBLE_DEVICES"
    words = f'if [ "$CUDA_VISIBLE_DEVICES" = 0 ]; then {lone}; else sleep 0.3; fi; '
    words += f"echo $CUDA_VISIBLE_DEVICES >> {driver}/where"
    places = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in ("0", "0", "1", "1")]
    assert {*work_at(driver, {f"job{i}": [words] for i in range(8)}, places).states.values()} == {"done"}
    where = (driver / "where").read_text().split()
    assert where.count("1") > where.count("0") > 0
