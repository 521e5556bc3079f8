"""ADAPTATION: only the common policy learns the new task, from the source domain (paper, Section 4.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.settings import PositiveInt
from datamodules.types import Batch, BatchSpec, Observation, Steps
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods.optimization import FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp.policy import PortablePolicy


class Adaptation(Phase[PortablePolicy]):
    """Behavioural cloning of the target task with encoder and decoder frozen (paper, Eq. 6, Algorithm 2).

    The encoder never changes here, so the latent state of every step is computed once, when the phase
    begins, and looked up by row from then on; no image is read again, unless the decoder sees them.

    Args:
        policy: The aligned policy.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes what changes the learning rate; a constant rate if not given.
    """

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        epochs: PositiveInt = 50,
        optimizer: OptimizerFactory = FusedAdamW,
        lr_scheduler: SchedulerFactory | None = None,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.batch_spec = BatchSpec("mix", images=policy.decoder_sees_images)
        self.latents: dict[str, Tensor] = {}

    @property
    def frozen(self) -> dict[str, nn.Module]:
        """Everything but the common policy."""
        policy = self.policy
        eyes = {} if policy.image_encoder is None else {"image_encoder": policy.image_encoder}
        return {"scaler": policy.scaler, "encoder": policy.encoder, "decoder": policy.decoder, **eyes}

    def trained_parameters(self) -> Iterable[nn.Parameter]:
        """The common policy's."""
        return self.policy.common.parameters()

    def on_fit_start(self) -> None:
        """Encode every step of every domain."""
        self._encode_all()

    def on_validation_start(self) -> None:
        """The same, if there was no training before."""
        if not self.latents:
            self._encode_all()

    @torch.no_grad()
    def _encode_all(self) -> None:
        for domain, dataset in self.trainer.datamodule.datasets.items():  # type: ignore[attr-defined]
            chunks = torch.arange(self._rows_to_encode(dataset)).split(dataset.rows_at_a_time(8192))
            parts = [self._encode(domain, dataset.observation.take(rows)) for rows in chunks]
            self.latents[domain] = torch.cat(parts)

    def _rows_to_encode(self, dataset: DomainDataset) -> int:
        return len(dataset)

    def _encode(self, domain: str, observation: Observation[Tensor]) -> Tensor:
        return self.policy.encode({domain: observation.map(lambda x: x.to(self.device))})[domain]

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        """The policy's actions, from the latent states that are known already."""
        latent = {domain: self.latents[domain][s.row] for domain, s in steps.items()}
        latent_action = self.policy.latent_action(latent, {domain: s.task for domain, s in steps.items()})
        return self.policy.decode(latent_action, {domain: s.observation for domain, s in steps.items()})

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Behavioural cloning on the target task and the mixed-in alignment data."""
        steps = batch.steps
        loss = behavioural_cloning(self.predict(steps), {domain: s.action for domain, s in steps.items()})
        if self.logs_now:
            self.log_parts({"bc": loss}, sum(len(s.action) for s in steps.values()))
        return loss
