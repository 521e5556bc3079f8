"""BC: one flat policy for all domains and tasks, cloned."""

from plp_lightning.methods.bc.phases import BCAdaptation, BCCloning
from plp_lightning.methods.bc.policy import BCPolicy

__all__ = ["BCAdaptation", "BCCloning", "BCPolicy"]
