"""A domain discriminator as an alignment term, in the place of MMD (paper, ablation "-disc")."""

from __future__ import annotations

from torch import Tensor

from datamodules.settings import NonNegativeFloat, PositiveInt
from plp_lightning.methods.plp.losses import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    standardise_jointly,
)
from plp_lightning.methods.plp.networks import DomainDiscriminator
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms.base import AlignmentTerm, EncodedBatch
from plp_lightning.networks import with_frozen_parameters


class DomainAdversarial(AlignmentTerm):
    """Encoder against a discriminator of domains, which learns along.

    Each loss reaches one player only, so one optimizer step serves both.

    Args:
        policy: The policy that is aligned.
        weight: Weight of the encoder's loss.
        penalty_weight: γ of the penalty on the discriminator's slope, so that it can't become certain.
        layers: Hidden layers of the discriminator.
        hidden: Units in its hidden layers.
    """

    def __init__(
        self,
        policy: PortablePolicy,
        weight: NonNegativeFloat = 0.1,
        penalty_weight: NonNegativeFloat = 1.0,
        layers: PositiveInt = 4,
        hidden: PositiveInt = 192,
    ) -> None:
        super().__init__(policy)
        self.weight, self.penalty_weight = weight, penalty_weight
        self.discriminator = DomainDiscriminator(policy.latent_size, len(policy.domains), hidden, layers)

    def forward(self, batch: EncodedBatch) -> dict[str, tuple[Tensor, float]]:
        """``adversarial`` (the encoder's), ``discriminator`` and, unless it weighs nothing, ``penalty``."""
        latents = standardise_jointly([*batch.latent.values()])
        losses = {
            "adversarial": (domain_generator_loss(with_frozen_parameters(self.discriminator), latents), self.weight),
            "discriminator": (domain_discriminator_loss(self.discriminator, latents), 1.0),
        }
        if self.penalty_weight > 0:
            losses["penalty"] = (domain_r1_penalty(self.discriminator, latents), self.penalty_weight)
        return losses
