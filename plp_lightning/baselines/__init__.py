"""BASELINES: the methods that PLP is compared with, each a policy and its phases; a file a method."""

from plp_lightning.baselines.cdil import CdilPolicy
from plp_lightning.baselines.cdil_alignment import CdilAlignment
from plp_lightning.baselines.cdil_phases import CdilAdaptation, CdilDynamics, CdilPositions
from plp_lightning.baselines.contextual import ContextualPolicy
from plp_lightning.baselines.contextual_cloning import ContextualCloning
from plp_lightning.baselines.flat import FlatAdaptation, FlatCloning, FlatPolicy
from plp_lightning.baselines.gama import GamaPolicy
from plp_lightning.baselines.gama_phases import GamaAdaptation, GamaAlignment, GamaPretraining
from plp_lightning.baselines.state_only import StateOnlyAdaptation, StateOnlyAlignment, StateOnlyPolicy

__all__ = [
    "CdilAdaptation",
    "CdilAlignment",
    "CdilDynamics",
    "CdilPolicy",
    "CdilPositions",
    "ContextualCloning",
    "ContextualPolicy",
    "FlatAdaptation",
    "FlatCloning",
    "FlatPolicy",
    "GamaAdaptation",
    "GamaAlignment",
    "GamaPolicy",
    "GamaPretraining",
    "StateOnlyAdaptation",
    "StateOnlyAlignment",
    "StateOnlyPolicy",
]
