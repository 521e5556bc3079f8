"""States that no longer change while a phase lasts: each is computed once and looked up from then on."""

from __future__ import annotations

from typing import TypeVar

import torch
from torch import Tensor

from plp_lightning.methods.optimization import OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.translation.policy import TranslatingPolicy

T = TypeVar("T", bound=TranslatingPolicy)
ROWS_AT_A_TIME = 8192
NO_CHANGE = 1e-6


class CachedFeatures(Phase[T]):
    """A phase in which perception is frozen; it needs no images in its batches.

    Args:
        policy: The policy to train.
        epochs: Passes over the phase's data.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes what changes the learning rate; a constant rate if not given.
    """

    def __init__(
        self, policy: T, epochs: int, optimizer: OptimizerFactory, lr_scheduler: SchedulerFactory | None = None
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.states: dict[str, Tensor] = {}
        self.next_row: dict[str, Tensor] = {}

    def on_fit_start(self) -> None:
        self._cache_all()

    def on_validation_start(self) -> None:
        if not self.states:  # without training before
            self._cache_all()

    def before_and_after(self, domain: str, rows: Tensor) -> tuple[Tensor, Tensor]:
        """States ``(B, S_d)`` before and after the steps at ``rows (B,)``, all of which have a next observation."""
        states = self.states[domain]
        return states[rows], states[self.next_row[domain][rows]]

    def usual_change(self, domain: str) -> Tensor:
        """Root mean square ``(S_d,)`` of changes in a training step of the proxy tasks; 1 for columns that rest."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        rows = data.rows(data.proxy_tasks, "train", next_observation=True)[domain]
        before, after = self.before_and_after(domain, torch.from_numpy(rows).to(self.device))
        change = (after - before).square().mean(0).sqrt()
        return change.where(change > NO_CHANGE, 1)

    @torch.no_grad()
    def _cache_all(self) -> None:
        for domain, dataset in self.trainer.datamodule.datasets.items():  # type: ignore[attr-defined]
            chunks = torch.arange(len(dataset.observation)).split(dataset.rows_at_a_time(ROWS_AT_A_TIME))
            seen = (dataset.observation.take(rows).map(lambda x: x.to(self.device)) for rows in chunks)
            self.states[domain] = torch.cat([self.policy.features(domain, observation) for observation in seen])
            self.next_row[domain] = dataset.next_row.to(self.device)
