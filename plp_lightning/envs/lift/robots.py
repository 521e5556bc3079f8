"""The robots of R2R-Lift: their joints, and how their fingers close."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

Robot = Literal["Sawyer", "UR5e", "Panda", "Kinova3"]


class Build(NamedTuple):
    """All that there is to know of a robot beside its model."""

    joints: int  # of the arm
    fingers: int  # joints of the fingers
    unit: str  # of these
    signs: tuple[float, ...]  # with which each finger's actuator follows the gripper command
    holds: tuple[float, float]
    """Sign and threshold of the first finger joint: beyond it the fingers are as closed as on a block."""


BUILDS: Mapping[Robot, Build] = {
    "Sawyer": Build(7, 2, "m", (1.0, -1.0), (-1.0, 0.0025)),
    "UR5e": Build(6, 6, "rad", (1.0, 1.0), (1.0, 0.385)),
    "Panda": Build(7, 2, "m", (-1.0, 1.0), (-1.0, 0.0215)),
    "Kinova3": Build(7, 6, "rad", (1.0, 1.0), (1.0, 0.385)),
}
