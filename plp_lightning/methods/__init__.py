"""METHODS: each a policy and its phases, in a folder with what it alone uses; the paper's method is the first.

``policy`` and ``phase`` hold what all have in common, ``translation`` what GAMA and CDIL share.
"""

from plp_lightning.methods.bc import BCAdaptation, BCCloning, BCPolicy
from plp_lightning.methods.cdil.alignment import CdilAlignment
from plp_lightning.methods.cdil.phases import CdilAdaptation, CdilDynamics, CdilPositions
from plp_lightning.methods.cdil.policy import CdilPolicy
from plp_lightning.methods.contextual.cloning import ContextualCloning
from plp_lightning.methods.contextual.policy import ContextualPolicy
from plp_lightning.methods.gama.phases import GamaAdaptation, GamaAlignment, GamaPretraining
from plp_lightning.methods.gama.policy import GamaPolicy
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.plp import Adaptation, Alignment, PortablePolicy
from plp_lightning.methods.policy import AligningPolicy, Policy
from plp_lightning.methods.state_only.phases import StateOnlyAdaptation, StateOnlyAlignment
from plp_lightning.methods.state_only.policy import StateOnlyPolicy

__all__ = [
    "Adaptation",
    "AligningPolicy",
    "Alignment",
    "BCAdaptation",
    "BCCloning",
    "BCPolicy",
    "CdilAdaptation",
    "CdilAlignment",
    "CdilDynamics",
    "CdilPolicy",
    "CdilPositions",
    "ContextualCloning",
    "ContextualPolicy",
    "GamaAdaptation",
    "GamaAlignment",
    "GamaPolicy",
    "GamaPretraining",
    "Phase",
    "Policy",
    "PortablePolicy",
    "StateOnlyAdaptation",
    "StateOnlyAlignment",
    "StateOnlyPolicy",
]
