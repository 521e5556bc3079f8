"""One engine under all simulators: many episodes of one MuJoCo model, advanced together on all cores.

An episode's state lives in a row of an array, not in an ``MjData``: a thread puts a row on its desk, advances it and
writes the result back. Rows carry the solver's warm start and the last controls too, so a row's future depends on
nothing but the row and its actions. A family gives the model and a function that advances some rows on a desk.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Generic, TypeVar

import mujoco
import numpy as np

from plp_lightning.envs.cores import available_cores
from plp_lightning.envs.native import STATE

R = TypeVar("R")
Change = Callable[[R, np.ndarray, np.ndarray, np.ndarray], object]
"""Takes a thread's room, rows ``(m,)``, their actions ``(m, A)`` and a mask ``(m,)``; advances the valid rows between
:func:`~plp_lightning.envs.native.load` and :func:`~plp_lightning.envs.native.save`, and marks those that diverge."""


class _Own(threading.local):
    """One pool thread's MjData and room. They die with their thread, in it, as an OpenGL context must."""

    data: mujoco.MjData | None = None
    room: Any = None


# Of the module, not of an engine: that may be let go by another thread, which would free another context's pictures.
_own = _Own()


class Engine(ABC, Generic[R]):
    """The states of E episodes, and the threads that advance them.

    Args:
        model: Model that is simulated; its automatic reset is switched off, since a diverged episode must be seen.
        threads: Number of threads; 0 means one for each core.
        least: Rows that a thread takes at a time at least, where the way to them costs more than one takes.
    """

    states: np.ndarray  # (E, S) float64

    def __init__(self, model: mujoco.MjModel, threads: int = 0, least: int = 1) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.model, self.threads, self.least = model, threads or available_cores(), least
        self.qpos, self.qvel = self.columns(mujoco.mjtState.mjSTATE_QPOS), self.columns(mujoco.mjtState.mjSTATE_QVEL)
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="physics")

    @abstractmethod
    def room(self, data: mujoco.MjData) -> R:
        """Make a thread's room of its MjData."""

    def columns(self, part: mujoco.mjtState) -> slice:
        """Columns of states ``(E, S)`` that hold one part, such as ``mjtState.mjSTATE_MOCAP_POS``."""
        start = mujoco.mj_stateSize(self.model, STATE & (int(part) - 1))
        return slice(start, start + mujoco.mj_stateSize(self.model, int(part)))

    def begin(self, episodes: int) -> None:
        """Make states ``(E, S)`` for so many episodes: the model's reference configuration at rest."""
        row = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, mujoco.MjData(self.model), row, STATE)
        self.states = np.tile(row, (episodes, 1))

    def advance(self, rows: np.ndarray, actions: np.ndarray, change: Change[R]) -> np.ndarray:
        """Advance rows ``(n,)`` by actions ``(n, A)``, shared out among the threads.

        Returns:
            Which are valid, ``(n,)`` bool: a row whose action is not finite or whose physics diverges is not, and
            keeps its last valid state.
        """
        rows, actions = np.ascontiguousarray(rows, np.int64), np.ascontiguousarray(actions, np.float64)
        valid: np.ndarray = np.isfinite(actions).all(axis=1)
        self.share(len(rows), lambda room, part: change(room, rows[part], actions[part], valid[part]))
        return valid

    def share(self, count: int, work: Callable[[R, slice], object]) -> None:
        """Do ``work`` on all parts of ``range(count)``, each in some thread's room."""
        parts = [*self._parts(count)]
        left = iter(parts)

        def labour() -> None:
            if _own.data is None:
                data = mujoco.MjData(self.model)
                _own.room, _own.data = self.room(data), data
            for part in left:  # whoever is free takes the next
                work(_own.room, part)

        for job in [self._pool.submit(labour) for _ in range(min(self.threads, len(parts)))]:
            job.result()

    def _parts(self, count: int) -> Iterator[slice]:
        """Shares of ``range(count)``, ever smaller, so that no thread waits long for the last."""
        start = 0
        while start < count:
            stop = min(count, start + max(self.least, (count - start) // (2 * self.threads)))
            yield slice(start, stop)
            start = stop
