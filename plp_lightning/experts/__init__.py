"""EXPERTS: who demonstrates."""

from plp_lightning.experts.lift import LiftExpert
from plp_lightning.experts.tabletop import ReachExpert, WindowExpert
from plp_lightning.experts.walker import WalkerExpert
from plp_lightning.experts.waypoint import WaypointExpert

__all__ = ["LiftExpert", "ReachExpert", "WalkerExpert", "WaypointExpert", "WindowExpert"]
