"""Checkpoints that later steps of a run go on from: found, undamaged, and the run's own."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

from datamodules.errors import CheckpointError
from plp_lightning.callbacks.checkpointing import check_owner, previous_checkpoint, read_checkpoint
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.records import file_hash


class Resumption(NamedTuple):
    """The place where an interrupted phase goes on."""

    checkpoint: Path
    step: int  # of the optimizers, until which curves are kept
    over: bool  # Training has ended by itself, before all epochs were through: evaluation alone is left


def resumption(run: RunDirectory, phase: str) -> Resumption | None:
    """Find where a phase goes on; None if it has to begin.

    A damaged checkpoint gives way to the one before it, and a line says so.

    Raises:
        CheckpointError: If the checkpoint is damaged and there is none before it, or it holds weights alone.
    """
    last = run.checkpoint(phase)
    if not last.exists() and not previous_checkpoint(last).exists():
        return None
    content = _read_or_restore(last)
    if "global_step" not in content:
        raise CheckpointError(f"{last}: holds weights alone; expected a state to go on from, as plp fit saves it")
    return Resumption(last, int(content["global_step"]), bool(content.get("stopped")))


def _read_or_restore(last: Path) -> dict[str, Any]:
    previous = previous_checkpoint(last)
    try:
        return read_checkpoint(last)
    except CheckpointError as error:
        if not previous.exists():
            raise
        content = read_checkpoint(previous)
        place = f"epoch {content.get('epoch')}, step {content.get('global_step')}"
        print(f"{error}\nplp: {last}: the one before takes its place; going on from {place}", file=sys.stderr)
        os.replace(previous, last)
        return content


def check_done(run: RunDirectory, phase: str) -> None:
    """Make sure that a phase is done, and that its record and the checkpoint that it handed on are what it left.

    Raises:
        CheckpointError: If the checkpoint is missing, damaged, of another run or phase, or a later one.
        ConfigError: If the phase is not done, or its record has changed.
    """
    handed = run.handed_on(phase)
    check_owner(read_checkpoint(handed), handed, run.identity, phase)
    run.check_done(phase)


def weights_before(experiment: Experiment, run: RunDirectory, name: str, origin: RunDirectory | None) -> Path | None:
    """Checkpoint that a phase begins with: what the phase before it handed on, in this run or in ``origin``.

    The run's record keeps its hash. None for the first phase.

    Raises:
        CheckpointError: If it is not what the phase had begun with when it was interrupted.
    """
    names = list(experiment.method.phases)
    if name == names[0]:
        return None
    before = names[names.index(name) - 1]
    giver = run if run.checkpoint(before).exists() or origin is None else origin
    check_done(giver, before)
    weights = giver.handed_on(before)
    digest = file_hash(weights)
    if run.phase_record(name).get("from_sha256", digest) != digest:
        remedy = "restore it, or begin a new run"
        raise CheckpointError(f"{weights}: is not the checkpoint that phase {name} of {run.path} began with; {remedy}")
    run.update_status("running", name, {"from": str(weights), "from_sha256": digest})
    return weights
