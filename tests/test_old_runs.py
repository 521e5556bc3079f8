"""Run directories and demonstrations of version 0.1.0 go on, are tested and loaded, though names have changed since.

``tests/old_runs`` holds runs on the smoke page with ``tests/conf/tiny.yaml`` as that version left them: two that were
finished, and four that were stopped in the middle of a phase. Their checkpoints were saved again with relative paths in
the place of absolute ones, and ``from_sha256`` is of what is here.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from command import ROOT, plp

import plp_lightning
from datamodules.types import Observation
from plp_lightning.runs.plans import CollectionConfig

OLD = Path(__file__).parent / "old_runs"
FINISHED, STOPPED = ("plp_t_disc", "bc"), ("plp_t", "gama", "cdil", "contextual")
SIZES = {"flat": 4, "tall": 7}
# A copied run is in another folder than its checkpoints remember.
pytestmark = pytest.mark.filterwarnings("ignore:The dirpath has changed")


def copied(method: str, folder: Path) -> Path:
    """The run of a method, with paths of the place where it is now."""
    shutil.copytree(OLD / "smoke" / method, folder / "runs" / "smoke" / method)
    run = folder / "runs" / "smoke" / method / "goal_3" / "seed_0"
    shutil.copy(OLD / "smoke.hdf5", folder)
    text = (run / "config.yaml").read_text()
    text = text.replace("run_root: runs\n", f"run_root: {folder / 'runs'}\n").replace(
        "root: data\n", f"root: {folder}\n"
    )
    (run / "config.yaml").write_text(text)
    return run


@pytest.mark.parametrize("method", STOPPED)
def test_a_stopped_run_goes_on(method: str, tmp_path: Path) -> None:
    run = copied(method, tmp_path)
    before = {file: file.read_bytes() for file in run.rglob("last.ckpt")}
    answer = plp("fit", "--resume", run)
    assert answer.code == 0, answer
    assert "names have changed: data.target is data.target_task" in answer.err
    results = json.loads((run / "results.json").read_text())
    assert (results["method"], results["target_task"]) == (method, "goal_3")
    done = [name for name, record in json.loads((run / "status.json").read_text())["phases"].items()]
    assert results["phases"] == done
    # The phase that was stopped went on, those before it stayed.
    changed = [file.parents[1].name for file, content in before.items() if file.read_bytes() != content]
    assert len(changed) == 1


@pytest.mark.parametrize("method", FINISHED)
def test_a_finished_run_is_tested(method: str, tmp_path: Path) -> None:
    answer = plp("test", copied(method, tmp_path), "--episodes", 2, "--output", tmp_path / "found.json")
    assert answer.code == 0, answer
    assert {*json.loads((tmp_path / "found.json").read_text())["trials"]} == {
        "target",
        "source",
        "proxy",
        "proxy_source",
    }


@pytest.mark.parametrize("method", [*FINISHED, *STOPPED])
def test_its_policy_is_loaded_and_acts(method: str, tmp_path: Path) -> None:
    run = copied(method, tmp_path)
    policy = plp_lightning.load_policy(run)
    last = sorted(run.rglob("last.ckpt"), key=lambda file: file.stat().st_mtime)[-1]
    saved = torch.load(last, weights_only=True)["state_dict"]
    ours = policy.state_dict()
    assert len(ours) == sum(name.startswith("policy.") for name in saved)
    domain = policy.acts_in[-1]
    action = policy.act(Observation(np.zeros((2, SIZES[domain]), np.float32)), domain=domain, task=["goal_0", "goal_1"])
    assert action.shape == (2, 2)
    assert np.isfinite(action).all()


def test_its_configuration_reruns(tmp_path: Path) -> None:
    run = copied("plp_t_disc", tmp_path)
    words = ["--config", run / "config.yaml", "--run_root", tmp_path / "again"]
    answer = plp("fit", *words, "--print_config")
    assert answer.code == 0, answer
    assert "DomainAdversarial" in answer.out
    assert "mmd: null" in answer.out
    assert "first_moment" in answer.out


def test_demonstrations_are_known_by_the_settings_that_they_were_made_with() -> None:
    recipe = {"linger": 15, "noise": 0.0, "wander": 3, "seed": 0}
    assert CollectionConfig(hold_steps=15, random_start_steps=3).differences(recipe) == {}
    assert CollectionConfig(hold_steps=14, random_start_steps=3).differences(recipe) == {"hold_steps": (15, 14)}


def test_the_runs_are_of_that_version() -> None:
    kept = [json.loads(file.read_text())["versions"]["plp-lightning"] for file in OLD.rglob("environment.json")]
    assert kept == ["0.1.0"] * len((*FINISHED, *STOPPED))
    assert (ROOT / "tests" / "old_runs" / "smoke.hdf5").exists()
