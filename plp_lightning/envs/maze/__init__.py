"""MAZES: point, ant and spider on the physics of Gymnasium-Robotics."""

from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze

__all__ = ["PointMaze", "WalkerMaze"]
