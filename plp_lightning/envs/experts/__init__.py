"""EXPERTS: who demonstrates."""

from plp_lightning.envs.experts.lift import LiftExpert
from plp_lightning.envs.experts.tabletop import ReachExpert, WindowExpert
from plp_lightning.envs.experts.walker import WalkerExpert
from plp_lightning.envs.experts.waypoint import WaypointExpert

__all__ = ["LiftExpert", "ReachExpert", "WalkerExpert", "WaypointExpert", "WindowExpert"]
