"""ADAPTATION: only the common policy learns the new task, from the source domain (paper, Section 4.2)."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.settings import NonNegativeFloat, PositiveInt
from datamodules.types import BatchSpec, Observation
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, OptimizerFactory, SchedulerFactory
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.support import SupportedCloning


class Adaptation(SupportedCloning):
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

    trains = PortablePolicy

    def __init__(
        self,
        policy: PortablePolicy,
        epochs: PositiveInt = 20,
        optimizer: OptimizerFactory = lambda p: FusedAdamW(p, lr=1e-3),
        lr_scheduler: SchedulerFactory | None = CosineDecay,
        support_weight: NonNegativeFloat = 0.0,
    ) -> None:
        super().__init__(policy, epochs, optimizer, lr_scheduler, support_weight)
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
