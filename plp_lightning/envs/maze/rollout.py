"""Many copies of one MuJoCo model, stepped together on all cores.

An episode's state lives in a row of an array, not in an ``MjData``: each thread copies a row into its
scratch ``MjData``, calls ``mj_step`` and copies the result back, all in compiled code without the GIL.
Rows carry the solver's warm start and the last controls too, so a row's future depends on nothing but the
row and its actions.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import llvmlite.binding  # type: ignore[import-untyped, unused-ignore]  # has no stubs
import mujoco
import numba
import numpy as np
from numba import types

from plp_lightning.envs.threads import available_cores

STATE = np.uint32(
    mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL
)
CHUNK = 8
"""Episodes that a thread takes at a time: small, so that no core waits for a slow one."""
DIVERGED = 1e6
"""A state beyond this in any coordinate has blown up."""

# Compiled code finds MuJoCo's C functions by name, so that it can be cached on disk.
llvmlite.binding.load_library_permanently(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))


def _c_function(name: str, *arguments: types.Type) -> Callable[..., None]:
    """A C function of MuJoCo for compiled code; pointers are passed as integers."""
    return cast("Callable[..., None]", types.ExternalFunction(name, types.void(*arguments)))


_POINTER = types.uintp
mj_step = _c_function("mj_step", _POINTER, _POINTER)
mj_forward = _c_function("mj_forward", _POINTER, _POINTER)
mj_get_state = _c_function("mj_getState", _POINTER, _POINTER, _POINTER, types.uint32)
mj_set_state = _c_function("mj_setState", _POINTER, _POINTER, _POINTER, types.uint32)


class BatchedPhysics:
    """Steps rows of states of one model.

    Args:
        model: The model; its automatic reset of diverged states is switched off.
        frame_skip: Physics steps for one control step.
        forward: Compute forces with ``mj_forward`` before each control step, as environments do that set the state
            there; it gives the solver another warm start.
        threads: Threads that step physics; 0 means one for each core this process may use.
    """

    def __init__(self, model: mujoco.MjModel, frame_skip: int, forward: bool = False, threads: int = 0) -> None:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self._model = model
        self._frame_skip = frame_skip
        self._forward = forward
        self._scratch = [mujoco.MjData(model) for _ in range(threads or available_cores())]
        self._pool = ThreadPoolExecutor(len(self._scratch))
        self.qpos = slice(1, 1 + model.nq)
        self.qvel = slice(1 + model.nq, 1 + model.nq + model.nv)

    def initial_states(self, episodes: int) -> np.ndarray:
        """The model's reference configuration at rest, ``(episodes, S)`` float64."""
        row = np.empty(mujoco.mj_stateSize(self._model, STATE))
        mujoco.mj_getState(self._model, mujoco.MjData(self._model), row, STATE)
        return np.tile(row, (episodes, 1))

    def forward(self, states: np.ndarray) -> np.ndarray:
        """The ``states (n, S)`` with the warm start that ``mj_forward`` computes for them; time stands still."""
        return self._run(states, np.zeros((len(states), self._model.nu)), forward=True, frame_skip=0)[0]

    def step(self, states: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Apply ``controls (n, U)`` to ``states (n, S)`` for one control step.

        Returns:
            The next states ``(n, S)`` and which of them are valid, ``(n,)`` bool. A row whose control is
            not finite or whose physics diverges keeps its old state and is not valid.
        """
        return self._run(states, controls, self._forward, self._frame_skip)

    def _run(
        self, states: np.ndarray, controls: np.ndarray, forward: bool, frame_skip: int
    ) -> tuple[np.ndarray, np.ndarray]:
        after = states.copy()
        valid: np.ndarray = np.isfinite(controls).all(axis=1)
        starts = iter(range(0, len(states), CHUNK))

        def work(scratch: Any) -> None:
            model, data = np.uintp(self._model._address), np.uintp(scratch._address)
            for start in starts:
                rows = slice(start, start + CHUNK)
                batch = after[rows], controls[rows], valid[rows]
                _advance(model, data, scratch.ctrl, *batch, forward, frame_skip)

        list(self._pool.map(work, self._scratch))
        valid &= (np.abs(after) < DIVERGED).all(axis=1)
        after[~valid] = states[~valid]
        return after, valid


@numba.njit(nogil=True, cache=True)
def _advance(
    model: np.uintp,
    data: np.uintp,
    ctrl: np.ndarray,
    states: Any,
    controls: np.ndarray,
    valid: np.ndarray,
    forward: bool,
    frame_skip: int,
) -> None:
    for row in range(len(states)):
        if valid[row]:
            state = states[row].ctypes.data
            mj_set_state(model, data, state, STATE)
            if forward:
                mj_forward(model, data)  # the forces of the last controls, as in the environment
            ctrl[:] = controls[row]
            for _ in range(frame_skip):
                mj_step(model, data)
            mj_get_state(model, data, state, STATE)
