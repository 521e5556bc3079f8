"""Where episodes went: a simulator that keeps every position it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.base import FloorPlan, Simulator
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.recorder import Recorder


@dataclass(frozen=True)
class Paths:
    """Where E episodes went, from their first state to their last."""

    tasks: tuple[str, ...]
    positions: tuple[np.ndarray, ...]
    """For each episode ``(T + 1, P)``, in the frame of :meth:`Simulator.shared_position`."""
    success: np.ndarray
    """``(E,)`` bool."""


class PathRecorder(Recorder):
    """Stands in for a simulator, does what it does, and keeps the positions of its newest episodes.

    Args:
        simulator: Who simulates.
        plan: Its floor plan.
    """

    def __init__(self, simulator: Simulator, plan: FloorPlan) -> None:
        super().__init__(simulator)
        self.plan = plan

    @property
    def paths(self) -> Paths:
        """Of the episodes since the last reset."""
        return Paths(self._tasks, tuple(np.array(positions) for positions in self._positions), self._success.copy())

    def _forget(self) -> None:
        self._positions: list[list[np.ndarray]] = [[] for _ in self._tasks]

    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        places = self.simulator.shared_position(observation.state)
        for episode, place in zip(episodes, places, strict=True):
            self._positions[episode].append(place)


def path_recorders(simulators: Mapping[str, Simulator], trials: Mapping[str, EvalSetting]) -> dict[str, PathRecorder]:
    """A recorder for each trial, by its name, whose domain has a floor plan."""
    plans = {name: simulators[trial.domain].floor_plan() for name, trial in trials.items()}
    return {name: PathRecorder(simulators[trials[name].domain], plan) for name, plan in plans.items() if plan}
