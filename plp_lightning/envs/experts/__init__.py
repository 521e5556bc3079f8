"""EXPERTS: the demonstrators of each family."""

from plp_lightning.envs.experts.lift import LiftExpert
from plp_lightning.envs.experts.metaworld import MetaWorldExpert
from plp_lightning.envs.experts.planar import PlanarArmExpert
from plp_lightning.envs.experts.robosuite import RobosuiteExpert
from plp_lightning.envs.experts.tabletop import ReachExpert, WindowExpert
from plp_lightning.envs.experts.waypoint import WalkerExpert, WaypointExpert

__all__ = [
    "LiftExpert",
    "MetaWorldExpert",
    "PlanarArmExpert",
    "ReachExpert",
    "RobosuiteExpert",
    "WalkerExpert",
    "WaypointExpert",
    "WindowExpert",
]
