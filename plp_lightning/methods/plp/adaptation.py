"""ADAPTATION: only the common policy learns the new task, from the source domain (paper, Section 4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.settings import NonNegativeFloat, PositiveInt
from datamodules.types import Batch, BatchSpec, Observation, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import CachedStates, step_count, tasks_of, weights_of
from plp_lightning.methods.plp.losses import support_distance
from plp_lightning.methods.plp.policy import PortablePolicy

KNOWN = 2048
"""Latent actions of proxy tasks that stand for all of them."""


class Adaptation(CachedStates[PortablePolicy]):
    """Behavioural cloning of the target task with encoder and decoder frozen (paper, Eq. 6, Algorithm 2).

    The encoder never changes here, so latent states are computed once; no image is read again, unless the decoder sees
    them.

    Args:
        policy: The aligned policy.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
        support_weight: Weight of :func:`plp_lightning.methods.plp.losses.support_distance`, which keeps latent actions
            to those that proxy tasks use, so that the target's decoder reads them as the source's does; 0 in the paper.
    """

    known: Tensor
    """Latent actions of the aligned policy in proxy tasks, ``(KNOWN, Z)``; NaN until the phase begins."""

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=1e-3),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
        support_weight: NonNegativeFloat = 0.0,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.batch_spec = BatchSpec("mix", images=policy.decoder_sees_images)
        self.support_weight = support_weight
        if support_weight > 0:
            self.register_buffer("known", torch.full((KNOWN, policy.latent_size), torch.nan))

    @property
    def frozen(self) -> dict[str, nn.Module]:
        policy = self.policy
        images = {} if policy.image_encoder is None else {"image_encoder": policy.image_encoder}
        return {"scaler": policy.scaler, "encoder": policy.encoder, "decoder": policy.decoder, **images}

    def parameter_groups(self) -> list[Any]:
        return [*self.policy.common.parameters()]

    def state_of(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        return self.policy.encode({domain: observation})[domain]

    def _rows_to_cache(self, dataset: DomainDataset) -> int:
        return len(dataset)

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
