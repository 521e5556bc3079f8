"""What a phase hands on can't be set impossibly, and is never taken if it is not what the phase left."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from command import complaint, plp, smoke_run, tiny_smoke
from forgery import flip_a_weight

import plp_lightning
from datamodules.errors import CheckpointError
from plp_lightning.callbacks.proxy_loss import ProxyLoss
from plp_lightning.runs.directory import RunDirectory

BEST = ["--handover.epoch", "best"]
IMPOSSIBLE = [
    ("average_over", "1.5", "average_over is 1.5; expected a share from 0 to 1"),
    ("average_over", "-0.1", "average_over is -0.1; expected a share from 0 to 1"),
    ("average_over", "nan", "expected a share from 0 to 1"),
    ("average_over", "null", "expected a share from 0 to 1"),
    ("average_over", "true", "expected a share from 0 to 1"),
    ("average_over", "{adaptation: 2}", "expected a share from 0 to 1"),
    ("average_over", "{adaptation: null}", "expected a share from 0 to 1"),
    ("average_over", "{adaptatoin: 0.1}", "names phase 'adaptatoin'; expected some of: alignment, adaptation"),
    ("epoch", "first", "handover.epoch is first; expected"),
    ("epoch", "null", "expected"),
    ("epoch", "{alignment: 3}", "expected"),
    ("epoch", "{pretraining: best}", "names phase 'pretraining'; expected some of: alignment, adaptation"),
]


@pytest.mark.parametrize(("key", "value", "told"), IMPOSSIBLE)
def test_impossible_handovers_are_named(key: str, value: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), f"--handover.{key}", value)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("{alignment: -1}", "evaluation.every_n_epochs"),
        ("-1", "evaluation.every_n_epochs is -1; expected a whole number, at least 0"),
        ("often", "evaluation.every_n_epochs is often; expected a whole number, at least 0"),
    ],
)
def test_impossible_times_of_evaluations_are_named(value: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--evaluation.every_n_epochs", value)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("which", ["best", "{adaptation: best}"])
def test_no_epoch_is_the_best_where_nothing_is_held_out(which: str, tmp_path: Path) -> None:
    words = [*tiny_smoke(tmp_path / "runs"), "--handover.epoch", which]
    told = complaint("fit", *words, "--data.val_fraction", "0")
    assert "handover.epoch is best, and data.val_fraction is 0; expected held-out demonstrations" in told
    assert not (tmp_path / "runs").exists()
    few = ["--data.proxy_tasks", "[goal_0]", "--data.trajectories", "1", "--data.source_trajectories", "14"]
    told = complaint("fit", *words, *few)
    assert "no demonstration of a proxy task is held out in target domain 'tall'; expected some" in told


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A run whose phases have handed on their first epochs, as the best."""
    root = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ProxyLoss, "_mean", lambda self, trainer, phase: float(trainer.current_epoch))
        answer = plp("fit", *tiny_smoke(root), *BEST)
    assert answer.code == 0, answer
    return smoke_run(root)


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "damaged": (flip_a_weight, "its content does not match its hash"),
    "missing": (Path.unlink, "no "),
    "of the other phase": (
        lambda best: shutil.copy(best.parents[2] / "alignment" / "checkpoints" / best.name, best),
        "is of another phase",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("verb", ["test", "validate", "predict", "export"])
def test_a_best_epoch_that_is_not_what_was_left_is_refused(
    verb: str, fault: str, finished: RunDirectory, tmp_path: Path
) -> None:
    run = RunDirectory(tmp_path / "run")
    shutil.copytree(finished.path, run.path)
    FAULTS[fault][0](run.checkpoint("adaptation", "best"))
    if fault == "missing" and verb == "export":  # takes the last phase that there is something of
        run.checkpoint("alignment", "best").unlink()
    assert FAULTS[fault][1] in complaint(verb, run.path)


def test_a_best_epoch_that_was_exchanged_is_refused(finished: RunDirectory, tmp_path: Path) -> None:
    run = RunDirectory(tmp_path / "run")
    shutil.copytree(finished.path, run.path)
    for phase in ("alignment", "adaptation"):
        shutil.copy(run.checkpoint(phase, "last"), run.checkpoint(phase, "best"))
    words = [*tiny_smoke(tmp_path / "later"), *BEST, "--phase", "adaptation", "--from", run.path]
    told = complaint("fit", *words)
    assert "alignment/checkpoints/best.ckpt: is not what phase alignment left when it was done" in told
    with pytest.raises(CheckpointError, match="is not what phase adaptation left"):
        plp_lightning.load_policy(run.path)
