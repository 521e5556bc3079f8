"""Being asked to stop: save at the next step's end, then leave with the signal's exit code."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer

from plp_lightning.stopping import PreemptedError, listen


class Preemption(Callback):
    """Turns a signal that asks to stop into a ``checkpoint`` and an exit code that schedulers understand.

    It saves at a step's end and leaves before the next step, when the one before has been logged, or after the last
    epoch, which has saved itself.

    Raises:
        PreemptedError: If a signal has come and the state is saved.
    """

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint, self.received, self.saved = checkpoint, 0, False
        self.previous: dict[int, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.previous = listen(self._notice)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if self.received and not self.saved:
            self.saved = True
            if batch_idx + 1 < trainer.num_training_batches:  # an epoch's end saves itself
                trainer.save_checkpoint(self.checkpoint)

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        if self.saved:
            raise PreemptedError(self.received)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.received:
            raise PreemptedError(self.received)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        while self.previous:
            signal.signal(*self.previous.popitem())

    def _notice(self, number: int, frame: FrameType | None) -> None:
        self.received = number
