"""A damaged last checkpoint gives way to the one before it, and the run comes to the same end."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from command import checkpoint, dies, plp, results, same, smoke_run, tiny_smoke
from forgery import flip_a_weight

from plp_lightning.callbacks.checkpointing import previous_checkpoint
from plp_lightning.runs.directory import RunDirectory

EPOCHS = ("--alignment.epochs", "4", "--adaptation.epochs", "4")
SAVED = "plp_lightning.callbacks.checkpointing:AtomicCheckpointIO.save_checkpoint"


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("unbroken")
    answer = plp("fit", *tiny_smoke(root), *EPOCHS)
    assert answer.code == 0, answer
    return smoke_run(root)


def killed(root: Path) -> RunDirectory:
    """A run that was killed in the third epoch of its alignment."""
    assert dies(["fit", *tiny_smoke(root), *EPOCHS], SAVED, 5, signal.SIGKILL) == -signal.SIGKILL
    return smoke_run(root)


def test_the_one_before_takes_over_and_nothing_is_lost(unbroken: RunDirectory, tmp_path: Path) -> None:
    run = killed(tmp_path)
    last = run.checkpoint("alignment")
    flip_a_weight(last)
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert "alignment/checkpoints/last.ckpt: the one before takes its place; going on from epoch" in answer.err
    assert results(run) == results(unbroken)
    for phase in ("alignment", "adaptation"):
        assert same(checkpoint(run, phase)["state_dict"], checkpoint(unbroken, phase)["state_dict"])
        assert same(checkpoint(run, phase)["optimizer_states"], checkpoint(unbroken, phase)["optimizer_states"])


@pytest.mark.parametrize("damage", ["cut", "removed"])
def test_whatever_happened_to_the_last_one(damage: str, unbroken: RunDirectory, tmp_path: Path) -> None:
    run = killed(tmp_path)
    last = run.checkpoint("alignment")
    content = last.read_bytes()
    last.unlink()
    if damage == "cut":
        last.write_bytes(content[: len(content) // 2])
    assert plp("fit", "--resume", run.path).code == 0
    assert results(run) == results(unbroken)


def test_without_one_before_the_damage_is_told(tmp_path: Path) -> None:
    run = killed(tmp_path)
    previous_checkpoint(run.checkpoint("alignment")).unlink()
    os.truncate(run.checkpoint("alignment"), 1000)
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 2
    assert "last.ckpt: not a plain checkpoint" in answer.err


def test_a_run_that_is_done_keeps_one_checkpoint(unbroken: RunDirectory) -> None:
    assert not [*unbroken.path.rglob("*.previous")]
