"""Time that a phase has taken, interruptions left out."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from lightning.pytorch import Callback, LightningModule, Trainer

from plp_lightning.runs.directory import RunDirectory


class Stopwatch(Callback):
    """Goes on from the time in a phase's record, and writes it back after every epoch.

    So whoever kills a run takes no more than the time of one epoch out of its ``seconds``.
    """

    def __init__(self, run: RunDirectory, phase: str) -> None:
        self.run, self.phase = run, phase
        self.spent, self.began = run.phase_record(phase).get("seconds", 0.0), time.monotonic()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Write down the time when the block is left, by whatever way."""
        try:
            yield
        finally:
            self._write()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._write()

    def _write(self) -> None:
        seconds = self.spent + time.monotonic() - self.began
        self.run.update_status("running", self.phase, {"seconds": seconds})
