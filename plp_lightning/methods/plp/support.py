"""CLONING THROUGH LATENT ACTIONS from latent states that do not change, near latent actions that decoders know."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from datamodules.types import Batch, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import CachedStates, step_count, tasks_of, weights_of
from plp_lightning.methods.plp.losses import support_distance
from plp_lightning.methods.plp.policy import PortablePolicy

KNOWN = 2048
"""Latent actions of proxy tasks that stand for all of them."""


class SupportedCloning(CachedStates[PortablePolicy]):
    """Behavioural cloning plus λ :func:`plp_lightning.methods.plp.losses.support_distance`, where λ is above 0.

    Args:
        policy: The aligned policy.
        epochs: Passes over the phase's data.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
        support_weight: λ.
    """

    known: Tensor
    """Latent actions of the aligned policy in proxy tasks, ``(KNOWN, Z)``; NaN until the phase begins."""

    def __init__(
        self,
        policy: PortablePolicy,
        epochs: int,
        optimizer: OptimizerFactory,
        lr_scheduler: SchedulerFactory | None,
        support_weight: float,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.support_weight = support_weight
        if support_weight > 0:
            self.register_buffer("known", torch.full((KNOWN, policy.latent_size), torch.nan))

    def on_fit_start(self) -> None:
        super().on_fit_start()
        if self.support_weight > 0 and self.known.isnan().any():  # a phase that goes on has them in its checkpoint
            self.known.copy_(self._latent_actions_of_proxies())

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        if self.support_weight == 0:
            return super().training_step(batch, batch_idx)
        steps, weights = batch.steps, weights_of(batch.steps)
        latent_action = self._latent_action(steps)
        demonstrated = {domain: s.action for domain, s in steps.items()}
        cloning = behavioural_cloning(self._decode(latent_action, steps), demonstrated, self.bc_reduction, weights)
        away = support_distance(latent_action, self.known, weights)
        loss = cloning + self.support_weight * away
        self.log_parts({"bc": cloning, "support": away, "loss": loss}, step_count(steps))
        return loss

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        return self._decode(self._latent_action(steps), steps)

    def _latent_action(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        latent = {domain: self.states[domain][s.row] for domain, s in steps.items()}
        return self.policy.latent_action(latent, tasks_of(steps))

    def _decode(self, latent_action: Mapping[str, Tensor], steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        return self.policy.decode(latent_action, {domain: s.observation for domain, s in steps.items()})

    @torch.no_grad()
    def _latent_actions_of_proxies(self) -> Tensor:
        """Latent actions ``(KNOWN, Z)`` in proxy tasks, as many of each domain, evenly spread over its steps."""
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        rows = data.rows(data.proxy_tasks, "train")
        shares = [len(share) for share in np.array_split(np.arange(KNOWN), len(rows))]
        found = []
        for (domain, own), count in zip(rows.items(), shares, strict=True):
            chosen = torch.from_numpy(own[np.linspace(0, len(own) - 1, count).astype(int)])
            task = data.datasets[domain].task[chosen].to(self.device)
            latent = self.states[domain][chosen.to(self.device)]
            found.append(self.policy.latent_action({domain: latent}, {domain: task})[domain])
        return torch.cat(found)
