"""A run that is killed anywhere and resumed ends with the weights of one that was not."""

from __future__ import annotations

import json
import os
import shutil
import signal
from pathlib import Path

import pytest
from command import checkpoint, complaint, data_root, dies, plp, results, same, smoke_run, tiny_smoke
from forgery import forge

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows
from plp_lightning.runs.progress import JobProgress

STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"
EVALUATION = "plp_lightning.runs.experiment:evaluate_all"
CONNECTOR = "lightning.pytorch.trainer.connectors.logger_connector.logger_connector"
PHASES = ("alignment", "adaptation")
SCHEDULES = ["--alignment.lr_scheduler", "CosineDecay", "--adaptation.lr_scheduler", "CosineDecay"]
ALL = ["--alignment.terms.tcc", "TCC", "--alignment.terms.adversarial", "DomainAdversarial", *SCHEDULES]
"""All losses at once, so that every stream of random numbers is in play, and rates that change. Steps 1 to 6 and 7 to
12 are its epochs of alignment, 13 to 15 and 16 to 18 those of adaptation."""


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("unbroken")
    answer = plp("fit", *tiny_smoke(root), *ALL)
    assert answer.code == 0, answer
    return smoke_run(root)


def assert_same_run(run: RunDirectory, unbroken: RunDirectory) -> None:
    for phase in PHASES:
        ours, theirs = checkpoint(run, phase), checkpoint(unbroken, phase)
        assert same(ours["state_dict"], theirs["state_dict"]), phase
        assert same(ours["optimizer_states"], theirs["optimizer_states"]), phase
        assert same(checkpoint(run, phase, "best")["state_dict"], checkpoint(unbroken, phase, "best")["state_dict"])
        assert read_rows(run.phase(phase) / "metrics.csv") == read_rows(unbroken.phase(phase) / "metrics.csv")
    assert results(run) == results(unbroken)
    assert run.status()["state"] == "done"


MOMENTS = {
    "first step": (STEP, 1),
    "second epoch of alignment": (STEP, 8),
    "adaptation": (STEP, 14),
    "before evaluation of alignment": (EVALUATION, 1),
    "between phases": ("plp_lightning.runs.fit:load_policy_weights", 1),
    "final evaluation": (EVALUATION, 2),
    **{f"file {n} written, not moved": ("datamodules.store.atomic:os.replace", n) for n in (1, 9, 14)},
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_killed_run_resumes_to_the_same_weights(moment: str, tmp_path: Path, unbroken: RunDirectory) -> None:
    options = [*tiny_smoke(tmp_path), *ALL]
    assert dies(["fit", *options], *MOMENTS[moment], signal.SIGKILL) == -signal.SIGKILL
    run = smoke_run(tmp_path)
    # Killed before its config was there, the run has never begun.
    answer = plp("fit", "--resume", run.path) if run.config.exists() else plp("fit", *options)
    assert answer.code == 0, answer
    assert_same_run(run, unbroken)
    assert not list(run.path.rglob("*.tmp"))


@pytest.mark.parametrize("step", [3, 6, 12, 14, 18])
def test_stopped_run_saves_says_so_and_resumes_exactly(step: int, tmp_path: Path, unbroken: RunDirectory) -> None:
    assert dies(["fit", *tiny_smoke(tmp_path), *ALL], STEP, step, signal.SIGTERM) == 128 + signal.SIGTERM
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "preempted"
    assert checkpoint(run, "adaptation" if run.checkpoint("adaptation").exists() else "alignment")["global_step"] > 0
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert_same_run(run, unbroken)


@pytest.mark.parametrize(("phase", "nth"), [("alignment", 1), ("adaptation", 2)])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_run_stopped_in_an_evaluation_says_so_and_resumes_exactly(
    phase: str, nth: int, number: int, tmp_path: Path, unbroken: RunDirectory
) -> None:
    assert dies(["fit", *tiny_smoke(tmp_path), *ALL], EVALUATION, nth, number) == 128 + number
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "preempted"
    assert run.phase_record(phase)["state"] == "running"
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert_same_run(run, unbroken)


def test_run_stopped_in_its_collection_says_so_and_resumes_exactly(
    tmp_path: Path, unbroken: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = [*tiny_smoke(tmp_path), *ALL, "--data.root", str(tmp_path / "data")]
    with monkeypatch.context() as patch:
        # This very process is asked to stop when the first demonstrations have come.
        patch.setattr(JobProgress, "advance", lambda *words: os.kill(os.getpid(), signal.SIGTERM))
        answer = plp("fit", *options)
    assert (answer.code, answer.err.count("\n")) == (128 + signal.SIGTERM, 1)
    assert "stopped by SIGTERM; go on with plp fit --resume" in answer.err
    run = smoke_run(tmp_path)
    assert run.status()["state"] == "preempted"
    assert run.status()["phases"] == {}
    assert not [file for file in (tmp_path / "data").iterdir() if file.suffix != ".lock"]
    spent = run.status()["collection_seconds"]
    assert spent > 0
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert_same_run(run, unbroken)
    assert run.status()["collection_seconds"] > spent


@pytest.mark.parametrize(("where", "nth"), [(STEP, 8), (EVALUATION, 1)])
def test_time_before_a_kill_is_counted(where: str, nth: int, tmp_path: Path) -> None:
    assert dies(["fit", *tiny_smoke(tmp_path), *ALL], where, nth, signal.SIGKILL) == -signal.SIGKILL
    run = smoke_run(tmp_path)
    assert run.phase_record("alignment")["seconds"] > 0
    run.update_status("running", "alignment", {"seconds": 1000.0})
    assert plp("fit", "--resume", run.path).code == 0
    seconds = json.loads(run.results.read_text())["seconds"]
    assert seconds["alignment"] > 1000
    assert 0 < seconds["adaptation"] < 1000


def test_finished_run_is_left_alone(unbroken: RunDirectory) -> None:
    before = {file: file.read_bytes() for file in unbroken.path.rglob("*") if file.is_file()}
    answer = plp("fit", "--resume", unbroken.path)
    assert answer.code == 0
    assert "done already" in answer.out
    assert {file: file.read_bytes() for file in unbroken.path.rglob("*") if file.is_file()} == before


def test_run_is_not_begun_twice(unbroken: RunDirectory) -> None:
    before = unbroken.results.read_bytes()
    told = complaint("fit", *tiny_smoke(unbroken.path.parents[3]))
    assert f"plp fit --resume {unbroken.path}" in told
    assert unbroken.results.read_bytes() == before


def test_two_processes_do_not_share_a_run(unbroken: RunDirectory, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "copy")
    shutil.copytree(unbroken.path, run.path)
    run.update_status("running")
    with run.locked():
        assert "another process works on this run" in complaint("fit", "--resume", run.path)


def test_phases_one_by_one_give_the_same_weights(tmp_path: Path, unbroken: RunDirectory) -> None:
    options = ["fit", *tiny_smoke(tmp_path), *ALL]
    assert plp(*options, "--phase", "alignment").code == 0
    first = smoke_run(tmp_path)
    assert not first.phase("adaptation").exists()
    assert plp(*options, "--phase", "adaptation", "--from", first.path, "--run_root", tmp_path / "later").code == 0
    second = smoke_run(tmp_path / "later")
    assert not second.phase("alignment").exists()
    for phase, run in zip(PHASES, (first, second), strict=True):
        assert same(checkpoint(run, phase)["state_dict"], checkpoint(unbroken, phase)["state_dict"])
    assert results(second) == {**results(unbroken), "phases": ["adaptation"]}


def test_changed_demonstrations_stop_a_resumed_run(tmp_path: Path) -> None:
    shutil.copytree(data_root(), tmp_path / "data")
    options = [*tiny_smoke(tmp_path), "--data.root", tmp_path / "data"]
    assert dies(["fit", *map(str, options)], STEP, 8, signal.SIGTERM) == 143
    run = smoke_run(tmp_path)
    weights = run.checkpoint("alignment").read_bytes()
    forge(tmp_path / "data" / "smoke.hdf5", "domains/flat/actions", 0, 0.5)
    told = complaint("fit", "--resume", run.path)
    assert "smoke.hdf5: the demonstrations have changed" in told
    assert run.checkpoint("alignment").read_bytes() == weights


def test_curves_of_an_epoch_are_written_before_its_checkpoint(tmp_path: Path) -> None:
    """A run that is killed right after one goes on behind them."""
    often = ["--evaluation.every_n_epochs.alignment", "1", "--evaluation.every_n_epochs.adaptation", "1"]
    assert plp("fit", *tiny_smoke(tmp_path / "whole"), *often).code == 0
    broken = ["fit", *tiny_smoke(tmp_path / "broken"), *often]
    after = f"{CONNECTOR}:_LoggerConnector.update_train_epoch_metrics"
    for nth in (1, 2):
        assert dies(broken, after, nth, signal.SIGKILL) == -signal.SIGKILL
        broken = ["fit", "--resume", str(smoke_run(tmp_path / "broken").path)]
    assert plp(*broken).code == 0
    for phase in ("alignment", "adaptation"):
        curves = [(smoke_run(tmp_path / name).phase(phase) / "metrics.csv").read_text() for name in ("whole", "broken")]
        assert "eval/target_success" in curves[0] or phase == "alignment"
        assert curves[0] == curves[1]
