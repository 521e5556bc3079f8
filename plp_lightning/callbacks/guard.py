"""Stops training on the first loss that is no number, and says which step it was."""

from __future__ import annotations

from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor

from datamodules.errors import UserError


class DivergedError(UserError):
    """Training produced a NaN or infinite loss."""


class FiniteGuard(Callback):
    """Stops where Lightning would train on silently, at a NaN.

    The loss is looked at every ``every_n_steps`` so that the check costs no synchronisation in between;
    a NaN stays a NaN, so none is missed, and parameters are checked before each checkpoint is written.

    Args:
        every_n_steps: Steps between two looks at the loss.

    Raises:
        DivergedError: If the loss is not finite, or a parameter when a checkpoint is to be written.
    """

    def __init__(self, every_n_steps: int = 20) -> None:
        self.every_n_steps = every_n_steps

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        loss: Tensor = outputs["loss"] if isinstance(outputs, dict) else outputs
        if batch_idx % self.every_n_steps == 0 and not torch.isfinite(loss).all():
            raise DivergedError(_message(trainer, pl_module, "the loss is not finite"))

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        # A checkpoint with a NaN must not replace a good one.
        bad = [name for name, p in pl_module.named_parameters() if not torch.isfinite(p).all()]
        if bad:
            raise DivergedError(_message(trainer, pl_module, f"parameter {bad[0]} is not finite"))


def _message(trainer: Trainer, pl_module: LightningModule, what: str) -> str:
    phase, place = type(pl_module).__name__, f"epoch {trainer.current_epoch}, step {trainer.global_step}"
    return f"{phase}, {place}: {what}; lower the learning rate (--alignment.lr) or look at the data (plp data validate)"
