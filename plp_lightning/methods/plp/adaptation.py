"""ADAPTATION: only the common policy learns the new task, from the source domain (paper, Section 4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.settings import PositiveInt
from datamodules.types import BatchSpec, Observation, Steps
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.phase import CachedStates, tasks_of
from plp_lightning.methods.plp.policy import PortablePolicy


class Adaptation(CachedStates[PortablePolicy]):
    """Behavioural cloning of the target task with encoder and decoder frozen (paper, Eq. 6, Algorithm 2).

    The encoder never changes here, so latent states are computed once; no image is read again, unless the decoder sees
    them.

    Args:
        policy: The aligned policy.
        epochs: Passes over the target task's data and its mix.
        optimizer: Makes the optimizer.
        lr_scheduler: Makes the schedule of the learning rate; a constant rate if null.
    """

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=1e-3),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler)
        self.batch_spec = BatchSpec("mix", images=policy.decoder_sees_images)

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

    def predict(self, steps: Mapping[str, Steps]) -> dict[str, Tensor]:
        latent = {domain: self.states[domain][s.row] for domain, s in steps.items()}
        latent_action = self.policy.latent_action(latent, tasks_of(steps))
        return self.policy.decode(latent_action, {domain: s.observation for domain, s in steps.items()})
