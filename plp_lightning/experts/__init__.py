"""EXPERTS: who demonstrates."""

from plp_lightning.experts.lift import LiftExpert
from plp_lightning.experts.walker import WalkerExpert
from plp_lightning.experts.waypoint import WaypointExpert

__all__ = ["LiftExpert", "WalkerExpert", "WaypointExpert"]
