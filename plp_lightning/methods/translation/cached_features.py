"""States that no longer change while a phase lasts: each is computed once and looked up from then on."""

from __future__ import annotations

from typing import TypeVar

import torch
from torch import Tensor

from datamodules.types import Course, Steps
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

    def on_fit_start(self) -> None:
        """Perceive every step of both domains."""
        self._cache_all()

    def on_validation_start(self) -> None:
        """The same, if there was no training before."""
        if not self.states:
            self._cache_all()

    def before_and_after(self, domain: str, steps: Steps) -> tuple[Tensor, Tensor]:
        """States ``(B, S_d)`` before and after the steps; after a trajectory's last step the same again."""
        states = self.states[domain]
        return states[steps.row], states[steps.row + ~course_of(steps).last]

    def usual_change(self, domain: str) -> Tensor:
        """Root mean square ``(S_d,)`` of what a training step of the proxy tasks changes; 1 for columns that rest."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        rows = torch.from_numpy(data.rows(data.proxy_tasks, "train")[domain])
        before, after = self.before_and_after(domain, data.datasets[domain].without_images().take(rows, course=True))
        change = (after - before).square().mean(0).sqrt()
        return change.where(change > NO_CHANGE, 1)

    @torch.no_grad()
    def _cache_all(self) -> None:
        for domain, dataset in self.trainer.datamodule.datasets.items():  # type: ignore[attr-defined]
            chunks = torch.arange(len(dataset)).split(dataset.rows_at_a_time(ROWS_AT_A_TIME))
            seen = (dataset.take(rows).observation.map(lambda x: x.to(self.device)) for rows in chunks)
            self.states[domain] = torch.cat([self.policy.features(domain, observation) for observation in seen])


def course_of(steps: Steps) -> Course:
    """Where the steps stand in their trajectories, which the phase's demand has to ask for."""
    assert steps.course is not None, "the phase's demand asks for no course"
    return steps.course
