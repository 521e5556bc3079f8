"""The one interface between this project and a simulator: many episodes, stepped together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation


class Step(NamedTuple):
    """What one control step brought, a row for each episode that was stepped."""

    observation: Observation[np.ndarray]
    """State ``(n, O)`` float32, image ``(n, H, W, C)`` uint8."""
    success: np.ndarray
    """``(n,)`` bool: the task is solved in this state."""
    invalid: np.ndarray
    """``(n,)`` bool: the simulation diverged or the action was not finite; the episode is over."""


@dataclass(frozen=True)
class FloorPlan:
    """A domain from above, in the frame of :meth:`Simulator.shared_position`: the first axis down, the second right.

    Args:
        walls: Centres of the square blocks that walls are made of, ``(W, 2)``.
        side: Side of a block.
        goals: Where each task ends.
        radius: Distance from its goal at which a task is solved.
    """

    walls: np.ndarray
    side: float
    goals: Mapping[str, tuple[float, float]]
    radius: float


class Simulator(ABC):
    """A domain that can be stepped: E episodes at once, physics on all of its threads.

    Construction is cheap and the object can be pickled until its first reset, which builds the model.
    An episode is a pure function of its task, its seed and its actions: neither the number of episodes
    stepped together nor their order changes it.
    """

    horizon: int
    """Control steps after which an unsolved episode counts as failed."""
    threads: int
    """Threads that step physics; 0 means one for each core. May be set until the first reset."""

    @property
    @abstractmethod
    def tasks(self) -> tuple[str, ...]:
        """Names of all tasks that this simulator knows, in their canonical order."""

    def target_tasks(self, target: str) -> tuple[str, ...]:
        """Tasks that make up ``target``: itself, or for instance one goal from each start zone."""
        return (target,)

    def target_of(self, task: str) -> str:
        """The target that ``task`` is part of, as :meth:`target_tasks` takes it."""
        return task

    @abstractmethod
    def proxy_tasks(self, target: str) -> tuple[str, ...]:
        """Tasks that may align the domains when ``target`` is to be transferred (none of its own)."""

    @abstractmethod
    def spec(self, name: str) -> DomainSpec:
        """Observation and action space, under the name that the experiment gives this domain."""

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Where raw states ``(N, O)`` are in a frame that all domains of an experiment share, ``(N, P)``.

        Two states of different domains correspond if they are at the same place; alignment scores use it.

        Raises:
            UserError: If nothing of the kind is known for this simulator.
        """
        raise UserError(f"{type(self).__name__} knows no position that domains share; choose another --score")

    def arrangement(self, task: str, seed: int) -> str | None:
        """What an episode of ``task`` with ``seed`` holds in which place, in a word, for pictures.

        None if all episodes of a task are arranged alike, but for continuous differences.
        """
        return None

    def floor_plan(self) -> FloorPlan | None:
        """Walls and goals, for pictures; None if this domain can't be drawn from above."""
        return None

    @abstractmethod
    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin E episodes, one for each (task, seed), and return their first observations ``(E, …)``."""

    @abstractmethod
    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Apply ``actions (n, A)`` for one control step to the ``episodes (n,)`` that still run.

        Actions are clipped to [-1, 1]. Rows of the result are in the order of ``episodes``.
        """


class Expert(ABC):
    """Who demonstrates: acts on many episodes of one simulator at once, from observations alone."""

    @abstractmethod
    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        """Get ready for E episodes that were just reset with these tasks and seeds."""

    @abstractmethod
    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)`` in [-1, 1] for the ``episodes (n,)`` whose observations are given."""


@dataclass
class Domain:
    """One entry of an experiment's ``domains``: what simulates it, and who demonstrates in it.

    Args:
        simulator: The domain's simulator.
        expert: Its demonstrator; None if demonstrations come from a file only.
    """

    simulator: Simulator
    expert: Expert | None = None
