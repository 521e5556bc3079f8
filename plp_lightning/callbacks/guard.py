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
    """Lightning trains on silently after a NaN; this raises instead.

    The loss is looked at every ``every_n_steps`` so that the check costs no synchronisation in between;
    a NaN stays a NaN, so none is missed, and parameters are checked before each checkpoint is written.

    Args:
        every_n_steps: Steps between two looks at the loss.
    """

    def __init__(self, every_n_steps: int = 20) -> None:
        self.every_n_steps = every_n_steps

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if batch_idx % self.every_n_steps == 0 and not torch.isfinite(_loss(outputs)).all():
            raise DivergedError(_message(trainer, pl_module, "the loss is not finite"))

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Look at the parameters: a checkpoint with a NaN must not replace a good one.

        Raises:
            DivergedError: If one is not finite.
        """
        bad = [name for name, p in pl_module.named_parameters() if not torch.isfinite(p).all()]
        if bad:
            raise DivergedError(_message(trainer, pl_module, f"parameter {bad[0]} is not finite"))


def _loss(outputs: Any) -> Tensor:
    loss: Tensor = outputs["loss"] if isinstance(outputs, dict) else outputs
    return loss


def _message(trainer: Trainer, pl_module: LightningModule, what: str) -> str:
    phase, place = type(pl_module).__name__, f"epoch {trainer.current_epoch}, step {trainer.global_step}"
    return f"{phase}, {place}: {what}; lower the learning rate (--alignment.lr) or look at the data (plp data validate)"
