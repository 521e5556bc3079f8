"""BASELINES: the methods that PLP is compared with, each a policy and its phases; a file or a folder a method.

What those share that translate states lies beside them: perception, a policy of two domains, known states.
"""

from plp_lightning.baselines.cdil import CdilAdaptation, CdilAlignment, CdilDynamics, CdilPolicy, CdilPositions
from plp_lightning.baselines.contextual import ContextualCloning, ContextualPolicy
from plp_lightning.baselines.flat import FlatAdaptation, FlatCloning, FlatPolicy
from plp_lightning.baselines.gama import GamaAdaptation, GamaAlignment, GamaPolicy, GamaPretraining
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
