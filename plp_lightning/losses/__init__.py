"""Losses: pure functions of tensors, each with its shapes and its equation."""

from plp_lightning.losses.adversarial import confusion, discrimination, in_units_of_spread, slope
from plp_lightning.losses.bc import behavioural_cloning
from plp_lightning.losses.mmd import mmd
from plp_lightning.losses.reconstruction import reconstruction
from plp_lightning.losses.tcc import tcc

__all__ = [
    "behavioural_cloning",
    "confusion",
    "discrimination",
    "in_units_of_spread",
    "mmd",
    "reconstruction",
    "slope",
    "tcc",
]
