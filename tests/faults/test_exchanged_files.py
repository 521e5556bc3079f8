"""A run goes on with its own files alone: not with another's checkpoint, not with a configuration that was edited."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from command import checkpoint, complaint, finished_smoke, plp, same, smoke_run, tiny_smoke

from datamodules.errors import CheckpointError
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, read_checkpoint
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.policies import load_policy

# A copied run is in another folder than its checkpoints remember.
pytestmark = pytest.mark.filterwarnings("ignore:The dirpath has changed")


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunDirectory]:
    """Finished runs that have the same sizes: another seed, and another weight of MMD."""
    root = tmp_path_factory.mktemp("others")
    for name, options in {"seed": ["--seed", "1"], "weight": ["--alignment.terms.mmd.weight", "0.3"]}.items():
        answer = plp("fit", *tiny_smoke(root / name), *options)
        assert answer.code == 0, answer
    return {"seed": smoke_run(root / "seed", seed=1), "weight": smoke_run(root / "weight")}


@pytest.fixture
def interrupted(others: dict[str, RunDirectory], tmp_path: Path) -> RunDirectory:
    """A run of seed 0 that is within its adaptation."""
    run = finished_smoke(tmp_path)
    run.results.unlink()
    status = run.status()
    status["phases"]["adaptation"]["state"] = "running"
    run.write_json("status.json", status | {"state": "running"})
    return run


@pytest.mark.parametrize("other", ["seed", "weight"])
@pytest.mark.parametrize("phase", ["alignment", "adaptation"])
def test_a_checkpoint_of_another_run_is_refused(
    phase: str, other: str, interrupted: RunDirectory, others: dict[str, RunDirectory]
) -> None:
    shutil.copy(others[other].checkpoint(phase), interrupted.checkpoint(phase))
    if phase == "alignment":
        shutil.rmtree(interrupted.phase("adaptation"))
        status = interrupted.status()
        interrupted.write_json("status.json", status | {"phases": {"alignment": status["phases"]["alignment"]}})
    told = complaint("fit", "--resume", interrupted.path)
    assert f"{phase}/checkpoints/last.ckpt: is of another run (" in told
    assert not interrupted.results.exists()


def test_a_checkpoint_of_another_phase_is_refused(interrupted: RunDirectory) -> None:
    shutil.copy(interrupted.checkpoint("alignment"), interrupted.checkpoint("adaptation"))
    told = complaint("fit", "--resume", interrupted.path)
    assert "adaptation/checkpoints/last.ckpt: is of another phase (alignment, expected adaptation)" in told


def test_weights_that_were_exchanged_later_are_refused(interrupted: RunDirectory) -> None:
    """They are the run's own, of that phase and in good order, but not what alignment left."""
    file = interrupted.checkpoint("alignment")
    AtomicCheckpointIO().save_checkpoint(read_checkpoint(file) | {"global_step": 3, "owner": None}, file)
    assert "is not what phase alignment left when it was done" in complaint("fit", "--resume", interrupted.path)
    status = interrupted.status()
    for later in ("sha256", "checkpoint_sha256"):  # which records of earlier versions lack
        del status["phases"]["alignment"][later]
    for begun in ("config_sha256", "plan_sha256"):
        del status[begun]
    interrupted.write_json("status.json", status)
    assert "is not the checkpoint that phase adaptation of" in complaint("fit", "--resume", interrupted.path)


@pytest.mark.parametrize(
    "edit",
    [
        {"seed": 7},
        {"method": "bc"},
        {"phases": ["alignment"]},
        {"data": {"batch_size": 7}},
        {"data": {"val_fraction": 0.3}},
        {"trainer": {"max_epochs": 9}},
        {"evaluation": {"final_episodes": 1}},
    ],
    ids=str,
)
def test_a_configuration_that_was_edited_is_refused(edit: dict[str, object], interrupted: RunDirectory) -> None:
    config = yaml.safe_load(interrupted.config.read_text())
    for key, value in edit.items():
        config[key] = config[key] | value if isinstance(value, dict) else value
    interrupted.config.write_text(yaml.safe_dump(config, sort_keys=False))
    for command in (["fit", "--resume"], ["test"], ["validate"], ["predict"]):
        assert "config.yaml: has changed since the run began" in complaint(*command, interrupted.path)
    assert not interrupted.results.exists()


def test_what_was_not_touched_goes_on(interrupted: RunDirectory) -> None:
    weights = checkpoint(interrupted, "adaptation")["state_dict"]
    assert plp("fit", "--resume", interrupted.path).code == 0
    assert same(checkpoint(interrupted, "adaptation")["state_dict"], weights)


@pytest.mark.parametrize("name", ["status.json", "config.yaml", "adaptation", "results.json"])
def test_links_out_of_a_run_are_not_followed(name: str, interrupted: RunDirectory, tmp_path: Path) -> None:
    outside, inside = tmp_path / "outside", interrupted.path / name
    if inside.exists():
        shutil.move(inside, outside)
    inside.symlink_to(outside)
    assert f"{name}: is a link" in complaint("fit", "--resume", interrupted.path)


@pytest.mark.parametrize("verb", ["test", "validate", "predict", "export"])
@pytest.mark.parametrize("which", ["last", "best"])
def test_nobody_looks_at_another_runs_policy(
    verb: str, which: str, interrupted: RunDirectory, others: dict[str, RunDirectory]
) -> None:
    shutil.copy(others["seed"].checkpoint("adaptation", which), interrupted.checkpoint("adaptation", which))
    assert f"{which}.ckpt: is of another run (" in complaint(verb, interrupted.path, "--which", which)


def test_nor_at_one_that_was_exchanged_later(interrupted: RunDirectory) -> None:
    file = interrupted.checkpoint("alignment")
    AtomicCheckpointIO().save_checkpoint(read_checkpoint(file) | {"global_step": 3}, file)
    assert "is not what phase alignment left" in complaint("test", interrupted.path, "--phase", "alignment")
    with pytest.raises(CheckpointError, match="is not what phase alignment left"):
        load_policy(interrupted.path, "alignment")


def test_a_run_whose_demonstrations_have_moved_is_looked_at_as_its_remedy_says(
    interrupted: RunDirectory, tmp_path: Path
) -> None:
    config, moved = yaml.safe_load(interrupted.config.read_text()), tmp_path / "moved.hdf5"
    here = Path(config["data"]["root"]) / "smoke.hdf5"
    shutil.copy(here, moved)
    hidden = here.rename(here.with_suffix(".away"))
    try:
        told = complaint("validate", interrupted.path)
        way = told.rpartition(" with ")[2].partition(" instead")[0].replace("FILE", str(moved)).split()
        assert plp("validate", *way).code == 0
    finally:
        hidden.rename(here)
