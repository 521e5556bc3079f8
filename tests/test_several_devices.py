"""One run on several devices is the run on one: the same losses, the same weights."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from command import METHODS, checkpoint, dies, plp, smoke_run, tiny_smoke
from ranks import codes, launched

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

NEAR = 1e-6
STEPS = ("--trainer.max_epochs", "1", "--data.epoch_steps", "50")
STEP = "plp_lightning.callbacks.guard:FiniteGuard.on_train_batch_end"
OVERLAYS = {path.stem: path for path in METHODS}
QUICK = ("plp", "plp_t", "plp_disc", "bc")


def furthest(one: RunDirectory, other: RunDirectory, phase: str) -> float:
    """Largest difference of any weight."""
    mine, theirs = (checkpoint(run, phase)["state_dict"] for run in (one, other))
    assert mine.keys() == theirs.keys()
    return max(float((mine[name].double() - theirs[name].double()).abs().max()) for name in mine if mine[name].numel())


def assert_same_curves(one: RunDirectory, other: RunDirectory, phase: str) -> None:
    mine, theirs = (read_rows(run.phase(phase) / "metrics.csv") for run in (one, other))
    assert [row[:2] for row in mine] == [row[:2] for row in theirs]
    assert len({row[0] for row in mine}) >= 50
    assert [float(row[2]) for row in mine] == pytest.approx([float(row[2]) for row in theirs], abs=NEAR, rel=NEAR)


@pytest.mark.parametrize("method", [m if m in QUICK else pytest.param(m, marks=pytest.mark.matrix) for m in OVERLAYS])
def test_two_ranks_are_the_same_run_as_one(method: str, tmp_path: Path) -> None:
    words = ["--config", str(OVERLAYS[method]), *STEPS]
    if method not in QUICK:  # some of which make too much of a last digit
        words += ["--trainer.precision", "64-true"]
    assert plp("fit", *tiny_smoke(tmp_path / "one"), *words).code == 0
    started = launched(["fit", *tiny_smoke(tmp_path / "two"), *words, "--trainer.devices", "2"], tmp_path / "said")
    assert codes(started) == [0, 0], (tmp_path / "said" / "0").read_text()
    assert (tmp_path / "said" / "1").read_text() == ""
    one, two = (smoke_run(tmp_path / name, method) for name in ("one", "two"))
    for phase in one.done_phases():
        assert furthest(one, two, phase) < NEAR
        assert_same_curves(one, two, phase)
    assert one.done_phases() == two.done_phases()


def test_a_run_goes_on_with_another_number_of_ranks(tmp_path: Path) -> None:
    assert plp("fit", *tiny_smoke(tmp_path / "whole"), *STEPS).code == 0
    words, run = [*tiny_smoke(tmp_path / "parts"), *STEPS], smoke_run(tmp_path / "parts")
    assert dies(["fit", *words], STEP, 11, signal.SIGTERM) == 128 + signal.SIGTERM
    resume = ["fit", "--resume", run.path, "--trainer.devices"]
    moment = (0, STEP, 30, signal.SIGTERM)
    assert codes(launched([*resume, 2], tmp_path / "said", moment=moment))[0] == 128 + signal.SIGTERM
    assert plp(*resume, "1").code == 0
    whole = smoke_run(tmp_path / "whole")
    for phase in whole.done_phases():
        assert furthest(whole, run, phase) < NEAR
        assert_same_curves(whole, run, phase)


def test_the_first_rank_starts_the_others_by_itself(tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), "--trainer.max_epochs", "1", "--trainer.devices", "2")
    assert answer.code == 0, answer
    assert answer.err == ""
    assert "run directory" in answer.out


SETTINGS = {
    "clipping": ["--trainer.gradient_clip_val", "0.1"],
    "accumulation": ["--trainer.accumulate_grad_batches", "3"],
    "half precision": ["--trainer.precision", "bf16-mixed"],
    "time": ["--trainer.max_time", "00:01:00:00", "--trainer.val_check_interval", "0.5"],
    "stopping": ["--callbacks+=EarlyStopping", "--callbacks.monitor", "val/bc", "--callbacks.patience", "1"],
    "averaging": ["--callbacks+=EMAWeightAveraging"],
    "handing on": ["--handover.average_over", "0.3", "--handover.epoch", "best"],
    "profile": ["--trainer.profiler", "simple"],
    "an odd share": ["--data.batch_size", "38", "--trainer.limit_train_batches", "7"],
}


@pytest.mark.parametrize(
    "setting", [pytest.param(s, marks=[] if s == "an odd share" else pytest.mark.matrix) for s in SETTINGS]
)
def test_the_trainers_settings_mean_the_same(setting: str, tmp_path: Path) -> None:
    words, total = [*SETTINGS[setting], "--trainer.max_epochs", "3", "--data.epoch_steps", "20"], 3
    words += [] if setting == "half precision" else ["--trainer.precision", "64-true"]
    assert plp("fit", *tiny_smoke(tmp_path / "one"), *words).code == 0
    words = ["fit", *tiny_smoke(tmp_path / "three"), *words, "--trainer.devices", str(total)]
    assert codes(launched(words, tmp_path / "said", total)) == [0] * total, (tmp_path / "said" / "0").read_text()
    one, three = (smoke_run(tmp_path / name) for name in ("one", "three"))
    for phase in one.done_phases():
        assert furthest(one, three, phase) < (0.05 if setting == "half precision" else NEAR)
