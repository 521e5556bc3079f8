"""Held-out loss of proxy tasks in the target domain, by which an epoch may be chosen without the target task."""

from __future__ import annotations

import torch
from lightning.pytorch import Callback, LightningModule, Trainer

from datamodules.errors import ConfigError
from datamodules.types import Batch
from plp_lightning.callbacks.evaluation import log_at_once
from plp_lightning.methods.phase import Phase, step_count

PROXY_LOSS = "val/proxy"


class ProxyLoss(Callback):
    """Logs ``val/proxy`` at the end of every epoch: the phase's loss on what is held out of the target domain.

    Its demonstrations are of proxy tasks alone, whatever the phase trains on or validates with.

    Raises:
        ConfigError: If none is held out there.
    """

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if not isinstance(pl_module, Phase):
            return
        data = trainer.datamodule  # type: ignore[attr-defined]
        self.batches = data.held_out_proxies(pl_module.batch_spec)
        if not len(self.batches):
            told = f"no demonstration of a proxy task is held out in target domain {data.target_domain!r}"
            raise ConfigError(f"{told}; expected some to tell the best epoch: add some, or set --handover.epoch last")

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if isinstance(pl_module, Phase):
            training = pl_module.training
            log_at_once(trainer, pl_module, {PROXY_LOSS: self._mean(trainer, pl_module.eval())})
            pl_module.train(training)

    @torch.no_grad()
    def _mean(self, trainer: Trainer, phase: Phase) -> float:
        total, count = 0.0, 0
        for batch in self.batches:
            with trainer.precision_plugin.val_step_context():
                loss = phase.proxy_loss(trainer.strategy.batch_to_device(batch, dataloader_idx=0))
            total, count = total + _size(batch) * float(loss), count + _size(batch)
        return total / count


def _size(batch: Batch) -> int:
    return step_count(batch.steps) + sum(len(frames.action) for frames in batch.pairs.values())
