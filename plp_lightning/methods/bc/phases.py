"""Cloning by a flat policy: of proxy tasks in every domain, then of the target task."""

from __future__ import annotations

from typing import Literal

from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.settings import PositiveInt
from datamodules.types import Batch, BatchSpec
from plp_lightning.methods.bc.policy import BCPolicy
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase


class BCCloning(Phase[BCPolicy]):
    """Behavioural cloning of the proxy tasks in every domain (paper, Eq. 1, with a flat policy).

    Args:
        policy: The policy to train.
        bc_reduction: Over action dimensions: ``mean``, or ``sum`` as printed in the paper.
        epochs: Passes over the proxy data, counted in samples of all domains together.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
        domains: Domains whose demonstrations are learnt, all if not given. One alone tells whether they can be cloned.

    Raises:
        ConfigError: If there is no such domain.
    """

    trains = BCPolicy
    batch_spec = BatchSpec("proxy_tasks")

    def __init__(
        self,
        policy: BCPolicy,
        bc_reduction: Literal["mean", "sum"] = "mean",
        epochs: PositiveInt = 100,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
        domains: list[str] | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        unknown = sorted({*(domains or [])} - policy.domains.keys())
        if unknown or domains == []:
            raise ConfigError(f"domains is {domains}; expected some of: {', '.join(policy.domains)}")
        self.bc_reduction, self.learnt = bc_reduction, frozenset(policy.domains if domains is None else domains)

    def _learnt_part(self, batch: Batch) -> Batch:
        return batch._replace(steps={d: s for d, s in batch.steps.items() if d in self.learnt})

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        super().validation_step(self._learnt_part(batch), batch_idx)

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        return super().training_step(self._learnt_part(batch), batch_idx)


class BCAdaptation(BCCloning):
    """Behavioural cloning of the target task in the source domain, mixed with proxies; nothing is frozen.

    Args:
        policy: The policy that has learnt the proxy tasks.
        bc_reduction: Over action dimensions: ``mean`` or ``sum``.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
    """

    batch_spec = BatchSpec("mix")

    def __init__(
        self,
        policy: BCPolicy,
        bc_reduction: Literal["mean", "sum"] = "mean",
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=5e-4),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
    ) -> None:
        super().__init__(policy, bc_reduction, epochs, optimizer, lr_scheduler)
