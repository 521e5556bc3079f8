"""CDIL: positions in time, translation, inverse dynamics, cloning."""

from plp_lightning.baselines.cdil.alignment import CdilAlignment
from plp_lightning.baselines.cdil.phases import CdilAdaptation, CdilDynamics, CdilPositions
from plp_lightning.baselines.cdil.policy import CdilPolicy

__all__ = ["CdilAdaptation", "CdilAlignment", "CdilDynamics", "CdilPolicy", "CdilPositions"]
