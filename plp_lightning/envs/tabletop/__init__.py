"""TABLETOP: Meta-World's arm, seen by a camera from one of two sides."""

from plp_lightning.envs.tabletop.simulator import Reach, Window

__all__ = ["Reach", "Window"]
