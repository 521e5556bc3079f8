"""Losses of the portable latent policy that align latent states: pure functions of tensors (paper, Section 4.1)."""

from plp_lightning.methods.plp.losses.adversarial import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    standardise_jointly,
)
from plp_lightning.methods.plp.losses.mmd import mmd
from plp_lightning.methods.plp.losses.support import support_distance
from plp_lightning.methods.plp.losses.tcc import tcc

__all__ = [
    "domain_discriminator_loss",
    "domain_generator_loss",
    "domain_r1_penalty",
    "mmd",
    "standardise_jointly",
    "support_distance",
    "tcc",
]
