"""SIMULATORS: one folder a family, stepped in batches behind one small interface; importing them is cheap."""

from plp_lightning.envs.base import Domain, Expert, Simulator, Step
from plp_lightning.envs.gym.simulator import Gymnasium
from plp_lightning.envs.lift.simulator import Lift
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.envs.planar import PlanarArm
from plp_lightning.envs.suites.metaworld import MetaWorld
from plp_lightning.envs.suites.robosuite import Robosuite
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert
from plp_lightning.envs.tabletop.simulator import Reach, Window
from plp_lightning.envs.tasks import Tasks

__all__ = [
    "Domain",
    "Expert",
    "Gymnasium",
    "Lift",
    "LinearPoint",
    "LinearPointExpert",
    "MetaWorld",
    "PlanarArm",
    "PointMaze",
    "Reach",
    "Robosuite",
    "Simulator",
    "Step",
    "Tasks",
    "WalkerMaze",
    "Window",
]
