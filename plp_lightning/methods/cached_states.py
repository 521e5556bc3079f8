"""States that no longer change while a phase lasts: each is computed once and looked up by row from then on."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor

from datamodules.batches.dataset import DomainDataset
from datamodules.types import Observation
from plp_lightning.methods.optimization import OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import P, Phase

ROWS_AT_A_TIME = 8192


class CachedStates(Phase[P]):
    """A phase that trains nothing of what makes its states; it needs no images in its batches for them.

    Args:
        policy: The policy to train.
        epochs: Passes over the phase's data.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes what changes the learning rate; a constant rate if not given.
    """

    def __init__(
        self, policy: P, epochs: int, optimizer: OptimizerFactory, lr_scheduler: SchedulerFactory | None = None
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.states: dict[str, Tensor] = {}
        self.next_row: dict[str, Tensor] = {}

    @abstractmethod
    def state_of(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        """State ``(B, S_d)`` of a domain's observation, ``(B, O)`` and ``(B, H, W, C)``."""

    def on_fit_start(self) -> None:
        self._cache_all()

    def on_validation_start(self) -> None:
        if not self.states:  # without training before
            self._cache_all()

    def before_and_after(self, domain: str, rows: Tensor) -> tuple[Tensor, Tensor]:
        """States ``(B, S_d)`` before and after the steps at ``rows (B,)``, all of which have a next observation."""
        states = self.states[domain]
        return states[rows], states[self.next_row[domain][rows]]

    def _rows_to_cache(self, dataset: DomainDataset) -> int:
        return len(dataset.observation)  # last observations too, which follow steps

    @torch.no_grad()
    def _cache_all(self) -> None:
        for domain, dataset in self.trainer.datamodule.datasets.items():  # type: ignore[attr-defined]
            chunks = torch.arange(self._rows_to_cache(dataset)).split(dataset.rows_at_a_time(ROWS_AT_A_TIME))
            seen = (dataset.observation.take(rows).map(lambda x: x.to(self.device)) for rows in chunks)
            self.states[domain] = torch.cat([self.state_of(domain, observation) for observation in seen])
            self.next_row[domain] = dataset.next_row.to(self.device)
