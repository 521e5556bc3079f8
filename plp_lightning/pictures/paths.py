"""Paths of episodes: an observer that keeps every position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.envs.views import FloorPlan, Located, Planned
from plp_lightning.evaluation.simulation import EvalSetting


@dataclass(frozen=True)
class Paths:
    """Ways of E episodes, from their first state to their last."""

    tasks: tuple[str, ...]
    positions: tuple[np.ndarray, ...]
    """For each episode ``(T + 1, P)``, in the frame that domains share."""
    success: np.ndarray
    """``(E,)`` bool."""


class PathRecorder(Observer):
    """Keeps the positions of the newest episodes.

    Args:
        simulator: The domain.
        plan: Its floor plan.
    """

    def __init__(self, simulator: Located, plan: FloorPlan) -> None:
        self.simulator, self.plan = simulator, plan

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self._tasks, self._success = tuple(tasks), np.zeros(len(tasks), dtype=np.bool_)
        self._positions = [[place] for place in self.simulator.shared_position(observation.state)]

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        places = self.simulator.shared_position(step.observation.state)
        for episode, place in zip(episodes, places, strict=True):
            self._positions[episode].append(place)

    def end(self, outcome: Episodes) -> None:
        self._success = outcome.success

    @property
    def paths(self) -> Paths:
        """Paths of the newest episodes."""
        return Paths(self._tasks, tuple(np.array(positions) for positions in self._positions), self._success.copy())


def path_recorders(simulators: Mapping[str, Simulator], trials: Mapping[str, EvalSetting]) -> dict[str, PathRecorder]:
    """A recorder for each trial, by its name, whose domain has a floor plan."""
    found = {name: simulators[trial.domain] for name, trial in trials.items()}
    return {name: PathRecorder(s, s.floor_plan()) for name, s in found.items() if isinstance(s, Planned)}
