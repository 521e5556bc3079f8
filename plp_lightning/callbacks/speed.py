"""Speed of a phase's training, as a curve."""

from __future__ import annotations

import time
from collections.abc import Sequence

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import Logger


class Speed(Callback):
    """Logs ``speed/steps_per_second`` of each epoch, held-out losses and evaluations left out.

    The clock is read around epochs alone, so that steps cost nothing. It stands before the callbacks that evaluate.

    Args:
        loggers: Those that hear of it. A run's ``metrics.csv`` does not, which is the same however often it is resumed.
    """

    def __init__(self, loggers: Sequence[Logger]) -> None:
        self.loggers = loggers
        self.began, self.paused, self.first = 0.0, 0.0, 0

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._begin(trainer)  # an epoch that is resumed has no start

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._begin(trainer)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.paused = time.monotonic()

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.began += time.monotonic() - self.paused

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        done, seconds = _steps(trainer), time.monotonic() - self.began
        if done > self.first and seconds > 0:
            for logger in self.loggers:
                logger.log_metrics({"speed/steps_per_second": (done - self.first) / seconds}, done - 1)

    def _begin(self, trainer: Trainer) -> None:
        self.began, self.first = time.monotonic(), _steps(trainer)


def _steps(trainer: Trainer) -> int:
    return trainer.fit_loop.epoch_loop._batches_that_stepped
