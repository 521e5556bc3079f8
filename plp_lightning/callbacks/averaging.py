"""Weights averaged over training: training goes on from the raw ones, everybody else sees the average."""

from __future__ import annotations

from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor

from datamodules.settings import Configured, Share
from plp_lightning.methods.phase import Phase

RAW, STEPS = "raw_weights", "averaged_steps"
"""Keys of a checkpoint beside its ``state_dict``, which holds the average."""


class AveragedWeights(Configured, Callback):
    """Averages a phase's weights over its steps; those of frozen parts and of discriminators stay as they are.

    The average is the mean of all weights so far until they are as many as it spans, N; then it moves by 1 / N towards
    each. Held-out losses, evaluation, pictures, checkpoints and whatever comes after the phase see it; before the next
    step the raw weights are back. A checkpoint holds both, so that a resumed run comes to the same average. Callbacks
    that are to see it come after this one.

    See "Acceleration of Stochastic Approximation by Averaging" (https://doi.org/10.1137/0330046).

    Args:
        over: Share of the phase's steps that the average spans.
    """

    def __init__(self, over: Share = 0.1) -> None:
        self.over, self.span = over, 1
        self.weights: dict[str, Tensor] = {}
        self.others: list[Tensor] = []  # The average while raw weights are in the phase, raw ones while it is shown
        self.loaded: dict[str, Tensor] = {}
        self.steps, self.seen, self.shown = 0, 0, False

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Begin with the raw weights, or with those of the checkpoint that the phase goes on from."""
        self.span = max(1, round(self.over * int(trainer.estimated_stepping_batches)))
        self.weights = pl_module.averaged_parameters() if isinstance(pl_module, Phase) else {}
        self.others = [self.loaded.get(name, own).to(own, copy=True) for name, own in self.weights.items()]
        self.loaded, self.shown, self.seen = {}, self.steps > 0, trainer.global_step

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self._show(average=False)

    @torch.no_grad()
    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if not self.weights or (taken := trainer.global_step) == self.seen:  # gradients are still gathered
            return
        self.seen, self.steps = taken, self.steps + 1
        share = 1 / min(self.steps, self.span)
        if share == 1:
            torch._foreach_copy_(self.others, [*self.weights.values()])
        else:
            torch._foreach_lerp_(self.others, [*self.weights.values()], share)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._show(average=True)

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._show(average=True)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._show(average=True)

    @torch.no_grad()
    def _show(self, average: bool) -> None:
        """Put the average, or the raw weights, into the phase; in place, for CUDA graphs know where they lie."""
        if average == self.shown or not self.weights:
            return
        own, self.shown = [*self.weights.values()], average
        kept = [weights.clone() for weights in own]
        torch._foreach_copy_(own, self.others)
        torch._foreach_copy_(self.others, kept)

    def on_save_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Let the checkpoint hold the average as the weights, and the raw ones beside it."""
        if not self.steps:
            return
        state, others = checkpoint["state_dict"], dict(zip(self.weights, self.others, strict=True))
        raw = others if self.shown else {name: state[name] for name in others}
        checkpoint["state_dict"] = state if self.shown else state | others
        checkpoint |= {RAW: raw, STEPS: self.steps}

    def on_load_checkpoint(self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]) -> None:
        """Keep the raw weights until training begins; the phase has the average by now."""
        self.loaded, self.steps = checkpoint.get(RAW, {}), checkpoint.get(STEPS, 0)
