"""The one interface between this project and a simulator: many episodes, stepped together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from datamodules.settings import Configured
from datamodules.types import DomainSpec, Observation
from plp_lightning.envs.tasks import Tasks


class Step(NamedTuple):
    """Result of one control step, a row for each episode that was stepped."""

    observation: Observation[np.ndarray]
    """State ``(n, O)`` float32, images ``(n, H, W, C)`` uint8 by camera."""
    success: np.ndarray
    """``(n,)`` bool: the task is solved in this state."""
    invalid: np.ndarray
    """``(n,)`` bool: the simulation diverged or the action was not finite; the episode is over."""
    over: np.ndarray | None = None  # (n,) bool: the episode has ended; None where time alone ends episodes


class Simulator(Configured, ABC):
    """A domain that can be stepped, E episodes at once: ``tasks``, ``spec``, ``reset`` and ``step`` are all it takes.

    What it may show beside that, for pictures and scores, is in :mod:`plp_lightning.envs.views`. Construction is cheap
    and the object can be pickled until its first reset, which builds the model. An episode is a pure function of its
    task, its seed and its actions: neither the number of episodes stepped together nor their order changes it.
    """

    horizon: int = 200  # Control steps after which an unsolved episode counts as failed
    needs: ClassVar[tuple[str, ...]] = ()
    """Modules that it imports at its first reset, and that the core of this project goes without."""
    imports: tuple[str, ...] = ()  # Packages of others that it imports: their user has to allow them
    threads: int = 0  # That step physics; 0 means one for each core. May be set until the first reset

    @property
    @abstractmethod
    def tasks(self) -> Tasks:
        """The tasks of this domain; an attribute of the class will do."""

    @abstractmethod
    def spec(self, name: str) -> DomainSpec:
        """States ``(O,)``, images and actions ``(A,)``, under the name that the experiment gives this domain."""

    @abstractmethod
    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin E episodes, one for each (task, seed), and return their first observations ``(E, …)``.

        Raises:
            ConfigError: If a task is unknown.
            UserError: If images cannot be drawn on this machine.
        """

    @abstractmethod
    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Apply actions ``(n, A)`` for one control step to the episodes ``(n,)`` that still run.

        Actions are clipped to [-1, 1]. Rows of the result are in the order of ``episodes``.
        """


class Expert(Configured, ABC):
    """Demonstrates: acts on many episodes of one simulator at once, from observations alone."""

    def check(self, simulator: Simulator) -> None:
        """Refuse, by a :class:`UserError`, what it can't demonstrate in, or with, before processes are started."""

    @abstractmethod
    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        """Get ready for episodes ``(E,)`` that were just reset with these tasks and seeds.

        Raises:
            ConfigError: If it demonstrates in other simulators than this one.
        """

    @abstractmethod
    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)`` in [-1, 1] of the episodes ``(n,)`` given, each bit for bit as if it were alone."""


@dataclass
class Domain:
    """One entry of an experiment's ``domains``: a simulator and its demonstrator.

    Args:
        simulator: The domain's simulator; None if it is known by its demonstrations alone.
        expert: Its demonstrator; None if demonstrations come from a file only.
    """

    simulator: Simulator | None = None
    expert: Expert | None = None

    @property
    def world(self) -> Simulator:
        """The simulator of a domain that is known to have one."""
        assert self.simulator is not None, "expected a domain with a simulator"
        return self.simulator
