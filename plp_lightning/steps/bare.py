"""A training step and nothing around it: loss, gradients, clipping, optimizer."""

from __future__ import annotations

from typing import cast

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.plugins.precision import MixedPrecision, Precision
from torch import Tensor

from datamodules.types import Batch

AROUND = (
    *("on_before_batch_transfer", "on_after_batch_transfer", "on_train_batch_start", "on_train_batch_end"),
    *("on_before_zero_grad", "optimizer_zero_grad", "on_before_backward", "on_after_backward"),
    *("on_before_optimizer_step", "optimizer_step", "configure_gradient_clipping"),
)
"""Lightning's hooks around a step that a bare step calls none of; ``backward`` is called."""


def takes_bare_steps(trainer: Trainer) -> bool:
    """Tell whether bare steps of the trainer's module change it as Lightning's own do, bit for bit."""
    plugin, module = trainer.precision_plugin, trainer.lightning_module
    scaled = type(plugin) is not Precision and not (type(plugin) is MixedPrecision and plugin.scaler is None)
    own = any(getattr(type(module), name) is not getattr(LightningModule, name, None) for name in AROUND)
    whole = module.automatic_optimization and trainer.accumulate_grad_batches == 1
    return whole and not scaled and not own and trainer.strategy.model is module


def bare_step(trainer: Trainer, batch: Batch, batch_idx: int) -> Tensor:
    """Take a training step of the trainer's module; gives its loss, a scalar."""
    module, optimizer = trainer.lightning_module, trainer.optimizers[0]
    loss = cast("Tensor", trainer.strategy.training_step(batch, batch_idx))
    optimizer.zero_grad()
    module.backward(loss)
    trainer.strategy.post_backward(loss)
    if trainer.gradient_clip_val:
        module.clip_gradients(optimizer, trainer.gradient_clip_val, trainer.gradient_clip_algorithm)
    optimizer.step()
    return loss.detach()
