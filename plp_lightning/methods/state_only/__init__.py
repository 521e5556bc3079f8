"""PLP-T from source demonstrations without actions."""

from plp_lightning.methods.state_only.phases import StateOnlyAdaptation, StateOnlyAlignment
from plp_lightning.methods.state_only.policy import StateOnlyPolicy

__all__ = ["StateOnlyAdaptation", "StateOnlyAlignment", "StateOnlyPolicy"]
