"""Frozen means frozen: proven by hash, not by trust."""

from __future__ import annotations

import hashlib
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import WeightAveraging
from torch import nn
from torch.optim.swa_utils import AveragedModel

from plp_lightning.methods.phase import Phase


class FrozenPartsChangedError(RuntimeError):
    """A part that a phase declares frozen came out of training different."""


def module_hash(module: nn.Module) -> str:
    """SHA-256 over names, shapes and bytes of a module's parameters and buffers."""
    digest = hashlib.sha256()
    for name, tensor in sorted(module.state_dict().items()):
        digest.update(f"{name}{tuple(tensor.shape)}".encode())
        # numpy knows no bfloat16, but every tensor has bytes.
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()


class FreezeGuard(Callback):
    """Freezes the parts that a phase declares frozen, and hashes them before and after.

    ``requires_grad = False`` alone would let buffers move and leave dropout on, so the parts are also kept
    in eval mode. The first hashes travel in the checkpoint: a resumed run is held to those of its beginning.

    Raises:
        FrozenPartsChangedError: At the end, if a frozen parameter or buffer differs from before.
    """

    def __init__(self) -> None:
        self.before: dict[str, str] = {}

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        for module in _frozen(pl_module).values():
            module.requires_grad_(False)
        if self.before:
            self._compare(pl_module)
        self.before = self.before or _hashes(pl_module)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        for callback in trainer.callbacks:  # type: ignore[attr-defined]
            if isinstance(callback, WeightAveraging) and callback._average_model is not None:
                _average_exactly(callback._average_model)

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        for module in _frozen(pl_module).values():
            module.eval()  # again: Lightning calls ``train()`` on all

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._compare(pl_module)

    def state_dict(self) -> dict[str, Any]:
        return {"before": self.before}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.before = state_dict["before"]

    def _compare(self, phase: LightningModule) -> None:
        changed = [name for name, value in _hashes(phase).items() if value != self.before.get(name)]
        if changed:
            raise FrozenPartsChangedError(f"frozen parts changed during training: {', '.join(changed)}")


def _average_exactly(average: AveragedModel) -> None:
    """Make the average of equal numbers that number; rounding would let frozen parts drift from themselves."""
    rule = average.avg_fn
    if rule is not None:
        average.avg_fn = lambda mean, new, count: torch.where(mean == new, new, rule(mean, new, count))


def _hashes(phase: LightningModule) -> dict[str, str]:
    return {name: module_hash(module) for name, module in _frozen(phase).items()}


def _frozen(phase: LightningModule) -> dict[str, nn.Module]:
    return {**phase.policy.frozen, **phase.frozen} if isinstance(phase, Phase) else {}
