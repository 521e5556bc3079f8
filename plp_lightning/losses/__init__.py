"""Losses that several methods share: pure functions of tensors, each with its shapes and its equation."""

from plp_lightning.losses.bc import behavioural_cloning
from plp_lightning.losses.r1_penalty import r1_penalty, weighted_mean
from plp_lightning.losses.reconstruction import reconstruction

__all__ = ["behavioural_cloning", "r1_penalty", "reconstruction", "weighted_mean"]
