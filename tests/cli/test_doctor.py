"""``plp doctor`` on machines that have all, some or no renderers."""

from __future__ import annotations

import json
import os
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import pytest

from datamodules.errors import UserError
from plp_lightning.cli import doctor
from plp_lightning.cli.doctor import run_doctor
from plp_lightning.cli.verbs import find_verb
from plp_lightning.envs.rendering import speed as rendering
from plp_lightning.envs.rendering.backend import Backend, missing, works
from plp_lightning.envs.rendering.speed import frames_per_second


def machine(monkeypatch: pytest.MonkeyPatch, speeds: dict[Backend, float], packages: dict[str, str]) -> None:
    """Pretend that these renderers and packages are there."""

    def measure(backend: Backend) -> float:
        if backend not in speeds:
            raise UserError(missing(backend))
        return speeds[backend]

    monkeypatch.setattr(doctor, "frames_per_second", measure)
    monkeypatch.setattr(doctor, "versions", lambda: packages)
    monkeypatch.setattr(doctor, "gpus", lambda: {"usable": [], "present": [], "cuda": None, "reason": ""})


ALL = dict.fromkeys(doctor.PACKAGES, "1.0")


def test_json_says_what_works(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    machine(monkeypatch, {"osmesa": 432.1}, ALL)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    find_verb("doctor")(["--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["renderers"]["osmesa"] == {"frames_per_second": 432}
    assert "apt-get install libegl1 libgl1-mesa-dri" in found["renderers"]["egl"]["error"]
    assert found["cores"]["machine"] == os.cpu_count()
    assert 1 <= found["cores"]["available"] <= found["cores"]["machine"]
    assert found["threads"]["OMP_NUM_THREADS"] == "3"
    assert (found["packages"], found["missing"], found["advice"]) == (ALL, [], [])


def test_tables(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    machine(monkeypatch, {"egl": 560.0, "osmesa": 500.0}, ALL)
    run_doctor([])
    lines = capsys.readouterr().out.splitlines()
    rows = [[cell.strip() for cell in line.strip("│ ").split("│")] for line in lines if line.startswith("│")]
    assert ["egl", "560 frames/s a thread"] in rows
    assert ["mujoco", "1.0"] in rows
    assert lines[-1] == "all is well"


def test_advice_names_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    machine(monkeypatch, {}, {name: "1.0" for name in ALL if name not in ("metaworld", "mujoco")})
    run_doctor([])
    lines = capsys.readouterr().out.splitlines()
    assert "mujoco, metaworld: not installed; run pip install -e '.[sim]'" in lines
    assert any(line.endswith("apt-get install libegl1 libgl1-mesa-dri") for line in lines)
    assert any(line.endswith("apt-get install libosmesa6") for line in lines)


def test_unknown_options_are_named() -> None:
    with pytest.raises(UserError, match=r"unrecognized arguments: --quick; see plp doctor --help"):
        run_doctor(["--quick"])


def test_a_driver_that_crashes_is_a_backend_that_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    class Crashing:
        def __init__(self, *_: object) -> None: ...

        def __enter__(self) -> Crashing:
            return self

        def __exit__(self, *_: object) -> None: ...

        def submit(self, *_: object) -> Future[float]:
            future: Future[float] = Future()
            future.set_exception(BrokenProcessPool("terminated abruptly"))
            return future

    monkeypatch.setattr(rendering, "ProcessPoolExecutor", Crashing)
    with pytest.raises(UserError, match="osmesa does not work on this machine"):
        frames_per_second("osmesa")


@pytest.mark.parametrize("backend", [b for b in doctor.get_args(Backend) if works(b)])
def test_frames_are_counted_in_a_fresh_process(backend: Backend, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENGL_PLATFORM", "")  # other tests of this process may have settled on one
    assert frames_per_second(backend, seconds=0.05) > 0
