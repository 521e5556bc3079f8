"""PHASES: what is trained, on what, with which losses."""

from plp_lightning.phases.adaptation import Adaptation
from plp_lightning.phases.alignment import Alignment
from plp_lightning.phases.base import Phase

__all__ = ["Adaptation", "Alignment", "Phase"]
