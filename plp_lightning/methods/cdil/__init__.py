"""CDIL: positions in time, translation, inverse dynamics, cloning."""

from plp_lightning.methods.cdil.alignment import CdilAlignment
from plp_lightning.methods.cdil.phases import CdilAdaptation, CdilDynamics, CdilPositions
from plp_lightning.methods.cdil.policy import CdilPolicy

__all__ = ["CdilAdaptation", "CdilAlignment", "CdilDynamics", "CdilPolicy", "CdilPositions"]
