"""GAMA: a source policy, and maps of states and actions between the domains."""

from plp_lightning.methods.gama.phases import GamaAdaptation, GamaAlignment, GamaPretraining
from plp_lightning.methods.gama.policy import GamaPolicy

__all__ = ["GamaAdaptation", "GamaAlignment", "GamaPolicy", "GamaPretraining"]
