"""Where episodes went: a simulator that keeps every position it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.types import DomainSpec, Observation
from plp_lightning.envs.base import FloorPlan, Simulator, Step
from plp_lightning.evaluation.simulation import Trial


@dataclass(frozen=True)
class Paths:
    """Where E episodes went, from their first state to their last."""

    tasks: tuple[str, ...]
    positions: tuple[np.ndarray, ...]
    """For each episode ``(T + 1, P)``, in the frame of :meth:`Simulator.shared_position`."""
    success: np.ndarray
    """``(E,)`` bool."""


class PathRecorder(Simulator):
    """Stands in for a simulator, does what it does, and keeps the positions of its newest episodes.

    Args:
        simulator: Who simulates.
        plan: Its floor plan.
    """

    def __init__(self, simulator: Simulator, plan: FloorPlan) -> None:
        self.simulator, self.plan = simulator, plan
        self.horizon, self.threads = simulator.horizon, simulator.threads

    @property
    def tasks(self) -> tuple[str, ...]:
        """Those of the simulator."""
        return self.simulator.tasks

    def proxies(self, target: str) -> tuple[str, ...]:
        """Those of the simulator."""
        return self.simulator.proxies(target)

    def spec(self, name: str) -> DomainSpec:
        """That of the simulator."""
        return self.simulator.spec(name)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes, and forget those before."""
        observation = self.simulator.reset(tasks, seeds)
        self._tasks = tuple(tasks)
        self._success = np.zeros(len(tasks), dtype=bool)
        self._positions: list[list[np.ndarray]] = [[] for _ in tasks]
        self._keep(observation, np.arange(len(tasks)))
        return observation

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Step the episodes, and keep where they are now."""
        step = self.simulator.step(actions, episodes)
        self._keep(step.observation, episodes)
        # As in a rollout: solved once is solved, unless the simulation diverges later.
        self._success[episodes] = (self._success[episodes] | step.success) & ~step.invalid
        return step

    @property
    def paths(self) -> Paths:
        """Of the episodes since the last reset."""
        return Paths(self._tasks, tuple(np.array(positions) for positions in self._positions), self._success.copy())

    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        places = self.simulator.shared_position(observation.state)
        for episode, place in zip(episodes, places, strict=True):
            self._positions[episode].append(place)


def path_recorders(simulators: Mapping[str, Simulator], trials: Mapping[str, Trial]) -> dict[str, PathRecorder]:
    """A recorder for each trial, by its name, whose domain has a floor plan."""
    plans = {name: simulators[trial.domain].floor_plan() for name, trial in trials.items()}
    return {name: PathRecorder(simulators[trials[name].domain], plan) for name, plan in plans.items() if plan}
