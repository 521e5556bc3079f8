"""The demonstrator of planar arms: straight to the place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import PositiveFloat
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.planar import PlanarArm

DAMPING = 0.01  # m²: keeps joints slow where the arm is stretched


class PlanarArmExpert(Expert):
    """Moves the tip straight to its place, slower as it gets there; the joints follow by damped least squares.

    See Nakamura and Hanafusa, "Inverse Kinematic Solutions With Singularity Robustness for Robot Manipulator Control",
    https://doi.org/10.1115/1.3143764.

    Args:
        gain: Speed of the tip for each metre to the place, 1/s.
        fastest: The tip's greatest speed, m/s.
    """

    def __init__(self, gain: PositiveFloat = 2.0, fastest: PositiveFloat = 0.5) -> None:
        self.gain, self.fastest = gain, fastest

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, PlanarArm):
            raise ConfigError(
                f"PlanarArmExpert got simulator {type(simulator).__name__}; expected PlanarArm, pair them so"
            )
        self._simulator = simulator

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        arm, state = self._simulator, observation.state.astype(np.float64)
        joints, tip = state[:, :-2], state[:, -2:]
        velocity = self.gain * (arm.goals[episodes] - tip)
        velocity /= np.maximum(1, np.linalg.norm(velocity, axis=1, keepdims=True) / self.fastest)
        # A joint turns all that is beyond it: the tip moves across the line from the joint to it.
        starts = np.concatenate([np.zeros((len(tip), 1, 2)), arm.points(joints)[:, :-1]], axis=1)
        x, y = np.moveaxis(tip[:, None] - starts, 2, 0)
        jacobian = np.stack([-y, x], axis=1)
        damped = jacobian @ jacobian.swapaxes(1, 2) + DAMPING * np.eye(2)
        speeds = jacobian.swapaxes(1, 2) @ np.linalg.solve(damped, velocity[:, :, None])
        actions: np.ndarray = np.clip(speeds[:, :, 0] / arm.speed, -1, 1)
        return actions.astype(np.float32)
