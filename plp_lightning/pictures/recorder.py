"""Who stands in for a simulator to watch it: does what it does, and keeps of it what subclasses want."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from datamodules.types import DomainSpec, Observation
from plp_lightning.envs.base import FloorPlan, Simulator, Step


class Recorder(Simulator):
    """A simulator within; what is kept is of the episodes since the last reset.

    Args:
        simulator: Who simulates; may be a recorder itself.
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self.horizon, self.threads = simulator.horizon, simulator.threads

    @property
    def tasks(self) -> tuple[str, ...]:
        """Those of the simulator."""
        return self.simulator.tasks

    def target_tasks(self, target: str) -> tuple[str, ...]:
        """Those of the simulator."""
        return self.simulator.target_tasks(target)

    def proxy_tasks(self, target: str) -> tuple[str, ...]:
        """Those of the simulator."""
        return self.simulator.proxy_tasks(target)

    def spec(self, name: str) -> DomainSpec:
        """That of the simulator."""
        return self.simulator.spec(name)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """That of the simulator."""
        return self.simulator.shared_position(state)

    def floor_plan(self) -> FloorPlan | None:
        """That of the simulator."""
        return self.simulator.floor_plan()

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes, and forget those before."""
        observation = self.simulator.reset(tasks, seeds)
        self._tasks = tuple(tasks)
        self._success = np.zeros(len(tasks), dtype=np.bool_)
        self._forget()
        self._keep(observation, np.arange(len(tasks)))
        return observation

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Step the episodes, and keep what they show now."""
        step = self.simulator.step(actions, episodes)
        self._keep(step.observation, episodes)
        # As in a rollout: solved once is solved, unless the simulation diverges later.
        self._success[episodes] = (self._success[episodes] | step.success) & ~step.invalid
        return step

    @abstractmethod
    def _forget(self) -> None:
        """Make room for episodes of ``self._tasks``."""

    @abstractmethod
    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        """Keep what is wanted of the observations of ``episodes (n,)``."""
