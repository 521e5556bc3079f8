"""Training of the contextual policy: a demonstration of each domain, both of one task (paper, appendix)."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import Tensor

from datamodules.batches.fixed import is_filled
from datamodules.batches.rounding import with_rows_that_recur
from datamodules.settings import PositiveInt
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, BatchSpec
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.contextual.denormals import without_denormals
from plp_lightning.methods.contextual.policy import ContextualPolicy, first_frames, last_frames
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase


class ContextualCloning(Phase[ContextualPolicy]):
    """Behavioural cloning of target-domain trajectories, each beside a source-domain trajectory of its task.

    The policy imitates all steps of a trajectory at once; which of the source domain's demonstrations of the task
    stands beside it is drawn anew for each batch. Only proxy tasks are trained on. Before training begins, one
    training demonstration of each task, the target task's included, is put aside in the policy: it is what the
    policy is shown when it acts. There is no adaptation: that would take demonstrations of both domains.

    Args:
        policy: The policy to train.
        epochs: Passes over as many pairs as the target domain has trajectories.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if not given.
    """

    trains = ContextualPolicy

    def __init__(
        self,
        policy: ContextualPolicy,
        epochs: PositiveInt = 500,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=1e-3),
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.batch_spec = BatchSpec("none", pairs="whole", images=policy.sees)

    def on_fit_start(self) -> None:
        data: TransferDataModule = self.trainer.datamodule  # type: ignore[attr-defined]
        self.policy.prompts.choose(data.datasets[data.source_domain], prompt_episodes(data))

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss, frames = self._loss(batch)
        self.log_parts({"bc": loss}, frames)
        return loss

    def backward(self, loss: Tensor, *args: Any, **kwargs: Any) -> None:
        with without_denormals():
            super().backward(loss, *args, **kwargs)

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        loss, frames = self._loss(batch)
        for name in ("val/bc", f"val/bc_{self.policy.target.name}"):
            self.log(name, loss, batch_size=frames, on_epoch=True)

    def proxy_loss(self, batch: Batch) -> Tensor:
        return self._loss(batch)[0]

    def _loss(self, batch: Batch) -> tuple[Tensor, int]:
        """Mean over all steps, and how many there are."""
        domain, most = self.policy.target.name, self.policy.max_length
        shown = last_frames(batch.pairs[self.policy.source.name], most)
        episodes = first_frames(batch.pairs[domain], most)
        action = self.policy(*with_rows_that_recur(shown, episodes))[: len(episodes.action)]
        counted = {domain: episodes.mask.flatten().float()} if is_filled(episodes) else None
        return behavioural_cloning({domain: action}, {domain: episodes.action}, weight=counted), len(action)


def prompt_episodes(data: TransferDataModule) -> dict[int, int]:
    """Training demonstration of the source domain that stands for a task, by task index: one of median length."""
    length, found = np.diff(data.datasets[data.source_domain].offset), {}
    for task in (*data.proxy_tasks, *data.target_tasks):
        ids = data.episodes(data.source_domain, [task], "train")
        if len(ids):
            found[data.tasks.index(task)] = int(ids[np.argsort(length[ids], kind="stable")[len(ids) // 2]])
    return found
