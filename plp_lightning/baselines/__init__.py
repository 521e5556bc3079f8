"""BASELINES: the methods that PLP is compared with, each a policy and its phases; a file a method."""

from plp_lightning.baselines.cdil import CdilPolicy
from plp_lightning.baselines.cdil_alignment import CdilAlignment
from plp_lightning.baselines.cdil_phases import CdilAdaptation, CdilDynamics, CdilPositions
from plp_lightning.baselines.flat import FlatAdaptation, FlatCloning, FlatPolicy

__all__ = [
    "CdilAdaptation",
    "CdilAlignment",
    "CdilDynamics",
    "CdilPolicy",
    "CdilPositions",
    "FlatAdaptation",
    "FlatCloning",
    "FlatPolicy",
]
