"""What ``plp rollout`` cannot film is told in one line, before anything is run or written."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from command import SMOKE, complaint, finished_smoke

from datamodules.errors import UserError
from plp_lightning.envs import LinearPoint
from plp_lightning.envs.rendering.backend import missing
from plp_lightning.pictures import replay
from plp_lightning.runs.directory import RunDirectory

FEW = ["--episodes", "1", "--among", "2", "--size", "16", "16"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("rollout"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--domain", "tal"], "found domain 'tal'; expected one of: flat, tall"),
        (["--task", "goal_33"], "no target 'goal_33' in LinearPoint; .*did you mean 'goal_3'"),
        (["--task", ""], "no target '' in LinearPoint"),
        (["--episodes", "0"], "--episodes: found '0'; expected a whole number of at least 1"),
        (["--among", "-1"], "--among"),
        (["--seed", "-1"], "--seed"),
        (["--size", "0", "64"], "--size: found '0'; expected a whole number from 16 to 1024"),
        (["--size", "64"], "--size: expected 2 arguments"),
        (["--size", "64", "1025"], "--size: found '1025'"),
        (["--phase", "clone"], "--phase is 'clone'; the phases of .* are alignment, adaptation"),
        (["--camera", "front"], "unrecognized arguments: --camera front; see plp rollout --help"),
    ],
    ids=" ".join,
)
def test_what_cannot_be_filmed_is_told(words: list[str], told: str, run: RunDirectory, tmp_path: Path) -> None:
    assert re.search(told, complaint("rollout", run.path, *words, "--out", tmp_path / "films"))
    assert not (tmp_path / "films").exists()


def test_a_run_without_a_finished_phase_is_told(run: RunDirectory, tmp_path: Path) -> None:
    shutil.copytree(run.path, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "alignment")
    shutil.rmtree(tmp_path / "run" / "adaptation")
    assert "has no checkpoint yet; finish a phase with plp fit --resume" in complaint("rollout", tmp_path / "run")
    assert "is no run directory" in complaint("rollout", tmp_path)
    assert "nothing to look at; name a run directory" in complaint("rollout")
    assert "--checkpoint" in complaint("rollout", *SMOKE)


def test_a_file_where_the_folder_should_be_is_told(run: RunDirectory, tmp_path: Path) -> None:
    (tmp_path / "films").write_text("mine")
    assert str(tmp_path / "films") in complaint("rollout", run.path, *FEW, "--out", tmp_path / "films")
    assert (tmp_path / "films").read_text() == "mine"


def test_simulators_that_are_not_there_do_not_render_or_cannot_are_told(
    run: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dark(*_: object) -> Any:
        raise UserError(missing("egl"))

    monkeypatch.setattr(LinearPoint, "render", dark)
    assert "images cannot be drawn: egl does not work on this machine" in complaint("rollout", run.path)
    monkeypatch.setattr(replay, "Rendered", type("Nothing", (), {}))
    assert "domain 'tall' cannot be filmed: LinearPoint neither" in complaint("rollout", run.path)
    monkeypatch.setattr("plp_lightning.runs.experiment.Experiment.simulators", {})
    told = "domain 'tall' is known by its demonstrations alone; expected one with a simulator"
    assert told in complaint("rollout", run.path)


@pytest.mark.parametrize("verb", ["rollout", "test"])
def test_simulators_that_are_not_installed_are_told(
    verb: str, run: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LinearPoint, "needs", ("no_such_simulator",))
    told = complaint(verb, run.path)
    assert "LinearPoint needs no_such_simulator, which is not installed; install the simulators with" in told
