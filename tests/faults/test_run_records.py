"""What a run reads back of itself is as it wrote it: its status, its results, its curves."""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from command import checkpoint, complaint, finished_smoke, plp, results, same, tiny_smoke

from datamodules.errors import ConfigError
from plp_lightning.callbacks.checkpointing import AtomicCheckpointIO, read_checkpoint
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.policies import load_policy
from plp_lightning.runs.records import BEGUN

DONE = {"state": "done", "seconds": 1, "trials": {}, "alignment": {}}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("finished"))


@pytest.fixture
def done(finished: RunDirectory, tmp_path: Path) -> RunDirectory:
    shutil.copytree(finished.path, tmp_path / "run")
    return RunDirectory(tmp_path / "run")


@pytest.fixture
def interrupted(done: RunDirectory) -> RunDirectory:
    """A run that is about to adapt."""
    done.results.unlink()
    shutil.rmtree(done.phase("adaptation"))
    _change(done, {"state": "running"}, {"adaptation": None})
    return done


def _change(run: RunDirectory, status: Mapping[str, Any], phases: Mapping[str, Any] | None = None) -> None:
    """Write other things into status.json, phases merged by name, None removes one."""
    file = run.path / "status.json"
    content = json.loads(file.read_text())
    merged = {name: record for name, record in {**content["phases"], **(phases or {})}.items() if record is not None}
    file.write_text(json.dumps({**content, "phases": merged, **status}))


@pytest.mark.parametrize("verb", ["fit", "test", "validate", "predict", "export"])
def test_a_status_that_is_lost_is_missed_and_not_begun_anew(verb: str, done: RunDirectory) -> None:
    (done.path / "status.json").unlink()
    told = complaint(verb, *(["--resume"] if verb == "fit" else []), done.path)
    assert "status.json: is missing, though there are checkpoints; restore it" in told
    assert not (done.path / "status.json").exists()


@pytest.mark.parametrize(
    "status",
    [
        {"state": 3},
        {"state": "elsewhere"},
        {"wanted": "alignment"},
        {"wanted": ["alignmnt"]},
        {"wanted": [1, 2]},
        {"wanted": ["adaptation"]},
        {"origin": 3},
        {"origin": "/nonexistent"},
        {"collection_seconds": "long"},
        {"collection_seconds": -1},
        {"data_sha256": None},
        {"data_sha256": 3},
        {"data_sha256": "0" * 64},
        {"config_sha256": "0" * 64},
        {"phases": None},
        {"phases": {"alignment": []}},
    ],
    ids=str,
)
def test_a_status_that_was_edited_is_refused(status: dict[str, Any], interrupted: RunDirectory) -> None:
    _change(interrupted, status)
    complaint("fit", "--resume", interrupted.path)
    assert not interrupted.results.exists()


@pytest.mark.parametrize("text", ["", "NaN", "null", "[" * 100_000, "\ud800", '{"state": 1e999}'], ids=lambda t: t[:9])
def test_a_status_that_is_none_is_refused(text: str, interrupted: RunDirectory) -> None:
    (interrupted.path / "status.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    assert "status.json: " in complaint("fit", "--resume", interrupted.path)


@pytest.mark.parametrize(
    "phases",
    [
        {"alignment": {"state": "done"}},
        {"alignment": {**DONE, "seconds": "x"}},
        {"alignment": {**DONE, "seconds": float("nan")}},
        {"alignment": {**DONE, "trials": {"target": {"success": 2, "episodes": 1, "invalid": 0, "interval": [0, 1]}}}},
        {"alignment": {**DONE, "trials": {"target": {"success": 1, "episodes": 1, "invalid": 0, "interval": [0]}}}},
        {"alignment": {**DONE, "alignment": "x"}},
        {"adaptation": {"state": "running", "seconds": "x"}},
        {"adaptation": DONE},
    ],
    ids=str,
)
def test_records_of_phases_that_are_made_up_are_refused(phases: dict[str, Any], interrupted: RunDirectory) -> None:
    """The last of them would be a result with no checkpoint behind it."""
    _change(interrupted, {}, phases)
    complaint("fit", "--resume", interrupted.path)
    assert not interrupted.results.exists()


def test_a_number_that_was_edited_in_the_record_of_a_phase_is_noticed(done: RunDirectory) -> None:
    done.results.unlink()
    record = done.phase_record("adaptation")
    record["trials"]["target"]["success"] = 1.0
    _change(done, {"state": "running"}, {"adaptation": record})
    assert "the record of phase adaptation has changed" in complaint("fit", "--resume", done.path)


LOST = [
    *("config_sha256", "plan_sha256", "data_sha256", "results_sha256"),
    *("phases.alignment.sha256", "phases.alignment.checkpoint_sha256", "phases.adaptation.from_sha256"),
]


@pytest.mark.parametrize("key", LOST)
@pytest.mark.parametrize("left", ["", "_"], ids=["gone", "of another name"])
def test_a_status_that_has_lost_a_hash_is_of_no_earlier_version(key: str, left: str, done: RunDirectory) -> None:
    file = done.path / "status.json"
    status = json.loads(file.read_text())
    *path, name = key.split(".")
    record = functools.reduce(dict.__getitem__, path, status)
    digest = record.pop(name)
    record |= {name.replace("_", "-") + left: digest} if left else {}
    file.write_text(json.dumps(status))
    told = f"status.json: {key} is missing; expected the hash that plp fit writes"
    for words in (["fit", "--resume"], ["test"], ["report"]):
        assert told in complaint(*words, done.path)
    with pytest.raises(ConfigError, match=told):
        load_policy(done.path)


def test_a_run_whose_checkpoints_know_it_is_of_no_earlier_version(interrupted: RunDirectory) -> None:
    file = interrupted.path / "status.json"
    status = json.loads(file.read_text())
    file.write_text(json.dumps({key: value for key, value in status.items() if key not in BEGUN}))
    for verb in (["fit", "--resume"], ["test"], ["export"]):
        assert "is of another run (" in complaint(*verb, interrupted.path)


def test_status_of_an_earlier_version_goes_on(interrupted: RunDirectory, finished: RunDirectory) -> None:
    """It holds no hashes but that of the demonstrations, and its checkpoints do not say whose they are."""
    old = json.loads((interrupted.path / "status.json").read_text())
    phases = {n: {k: v for k, v in record.items() if "sha256" not in k} for n, record in old["phases"].items()}
    new = ("config_sha256", "plan_sha256", "results_sha256")
    status = {k: v for k, v in old.items() if k not in new} | {"phases": phases}
    (interrupted.path / "status.json").write_text(json.dumps(status))
    file = interrupted.checkpoint("alignment")
    AtomicCheckpointIO().save_checkpoint(read_checkpoint(file) | {"owner": None}, file)
    assert plp("fit", "--resume", interrupted.path).code == 0
    assert results(interrupted) == results(finished)


@pytest.mark.parametrize("text", ["{", "", "[]", "{}", '{"alignment": "x"}', "[" * 100_000], ids=lambda text: text[:9])
def test_results_that_were_edited_are_not_shown(text: str, done: RunDirectory) -> None:
    done.results.write_text(text)
    assert "results.json: " in complaint("fit", "--resume", done.path)


def test_one_digit_of_the_results_counts(done: RunDirectory) -> None:
    done.results.write_text(done.results.read_text().replace('"seed": 0', '"seed": 7'))
    assert "results.json: has changed since the run wrote it" in complaint("fit", "--resume", done.path)
    done.results.unlink()
    assert plp("fit", "--resume", done.path).code == 0
    assert json.loads(done.results.read_text())["seed"] == 0


@pytest.mark.parametrize(
    "odd",
    [
        b"\xff\x00\n" * 9,
        b"step,metric,value\nx,y,z\n",
        b"step,metric,value\n" + b"9" * 9_999 + b",a,1\n",
        b"1,a\n1,b\n",
    ],
)
def test_curves_that_are_none_are_refused(odd: bytes, interrupted: RunDirectory) -> None:
    interrupted.phase("adaptation").mkdir()
    (interrupted.phase("adaptation") / "metrics.csv").write_bytes(odd)
    assert "metrics.csv: line 2 is" in complaint("fit", "--resume", interrupted.path)


def test_half_a_line_of_a_killed_run_is_dropped(interrupted: RunDirectory, finished: RunDirectory) -> None:
    interrupted.phase("adaptation").mkdir()
    curves = interrupted.phase("adaptation") / "metrics.csv"
    curves.write_bytes(b"step,metric,value\n0,train/b")
    assert plp("fit", "--resume", interrupted.path).code == 0
    assert curves.read_bytes() == (finished.phase("adaptation") / "metrics.csv").read_bytes()


def test_an_unfinished_alignment_is_not_built_upon(interrupted: RunDirectory, tmp_path: Path) -> None:
    _change(interrupted, {}, {"alignment": {"state": "running"}})
    told = complaint("fit", *tiny_smoke(tmp_path / "new"), "--phase", "adaptation", "--from", interrupted.path)
    assert "phase alignment is not done; finish it by plp fit --resume" in told


def test_what_was_not_touched_goes_on(interrupted: RunDirectory, finished: RunDirectory) -> None:
    assert plp("fit", "--resume", interrupted.path).code == 0
    assert results(interrupted) == results(finished)
    weights = (checkpoint(run, "adaptation")["state_dict"] for run in (interrupted, finished))
    assert same(*weights)
