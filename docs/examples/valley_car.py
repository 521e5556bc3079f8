"""Gymnasium's car in a valley as two domains, seen as it is or in a mirror; a task is where to park."""

from collections.abc import Sequence

import gymnasium
import numpy as np

from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs import Expert, Simulator, Step, Tasks

GOALS = {"far_left": -0.72, "left": -0.66, "right": -0.38, "far_right": -0.33}


class ValleyCar(Simulator):
    """MountainCarContinuous-v0: the car has parked within 2 cm of its goal at less than 0.3 cm a step."""

    tasks = Tasks("ValleyCar", tuple(GOALS))
    horizon = 100

    def __init__(self, mirrored: bool = False) -> None:
        self.sign = -1.0 if mirrored else 1.0

    def spec(self, name: str) -> DomainSpec:
        keys = (ObservationKey("position", (1,)), ObservationKey("velocity", (1,)))
        return DomainSpec(name, keys, action_size=1, control_hz=30.0, env=f"ValleyCar, sign {self.sign}")

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.goals = np.array([GOALS[task] for task in tasks])
        self.envs = [gymnasium.make("MountainCarContinuous-v0").unwrapped for _ in tasks]
        states = [env.reset(seed=seed)[0] for env, seed in zip(self.envs, seeds, strict=True)]
        return Observation(np.float32(self.sign) * np.stack(states))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        forces = self.sign * np.nan_to_num(np.clip(actions, -1, 1))
        states = np.stack([self.envs[i].step(force)[0] for i, force in zip(episodes, forces, strict=True)])
        parked = (np.abs(states[:, 0] - self.goals[episodes]) < 0.02) & (np.abs(states[:, 1]) < 0.003)
        return Step(Observation(np.float32(self.sign) * states), parked, ~np.isfinite(actions).all(axis=1))


class ParkingExpert(Expert):
    """Holds the car against the slope, and pulls it to its goal by spring and damper."""

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        assert isinstance(simulator, ValleyCar)
        self.simulator = simulator

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        position, velocity = self.simulator.sign * observation.state.T
        slope, way = np.cos(3 * position) / 0.6, self.simulator.goals[episodes] - position
        return self.simulator.sign * np.clip(slope + 10 * way - 150 * velocity, -1, 1)[:, None]
