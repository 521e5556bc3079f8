"""Being asked to stop: save at the next step's end, then leave with the signal's exit code."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer


class PreemptedError(Exception):
    """The process was asked to stop and has saved where it stands.

    Args:
        number: The signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_code = 128 + number


class Preemption(Callback):
    """Turns SIGTERM and SIGINT into a checkpoint and an exit code that schedulers understand.

    Args:
        checkpoint: Where to save.
    """

    def __init__(self, checkpoint: Path) -> None:
        self.checkpoint = checkpoint
        self.received = 0
        self.previous: dict[int, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Watch for signals while there is something to save."""
        for number in (signal.SIGTERM, signal.SIGINT):
            self.previous[number] = signal.signal(number, self._notice)

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save and leave, at a point that a resumed run can go on from.

        Raises:
            PreemptedError: If a signal has come.
        """
        if self.received:
            trainer.save_checkpoint(self.checkpoint)
            raise PreemptedError(self.received)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Give the signals back."""
        while self.previous:
            signal.signal(*self.previous.popitem())

    def _notice(self, number: int, frame: FrameType | None) -> None:
        self.received = number
