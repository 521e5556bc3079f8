"""Many copies of one MuJoCo model, stepped together on all cores.

An episode's state lives in a row of an array, not in an ``MjData``: each thread copies a row into its
scratch ``MjData``, calls ``mj_step`` and copies the result back, all in compiled code without the GIL.
Rows carry the solver's warm start and the last controls too, so a row's future depends on nothing but the
row and its actions.
"""

from __future__ import annotations

import ctypes
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numba
import numba.experimental.function_type  # lets numba pass C functions as arguments, so that its cache holds
import numpy as np
from numba import types

STATE = np.uint32(
    mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL
)
CHUNK = 8
"""Episodes that a thread takes at a time: small, so that no core waits for a slow one."""
DIVERGED = 1e6
"""A state beyond this in any coordinate has blown up."""


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
        self._scratch = [mujoco.MjData(model) for _ in range(threads or len(os.sched_getaffinity(0)))]
        self._pool = ThreadPoolExecutor(len(self._scratch))
        self._library = _library()
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
                _advance(self._library, model, data, scratch.ctrl, *batch, forward, frame_skip)

        list(self._pool.map(work, self._scratch))
        valid &= (np.abs(after) < DIVERGED).all(axis=1)
        after[~valid] = states[~valid]
        return after, valid


class _Library(NamedTuple):
    """MuJoCo's C functions that the compiled loop calls."""

    step: _CFunction
    forward: _CFunction
    set_state: _CFunction
    get_state: _CFunction


class _CFunction(types.WrapperAddressProtocol):
    """A C function by address, which numba compiles calls to without baking the address in."""

    def __init__(self, function: Any, arguments: int) -> None:
        self._address = ctypes.cast(function, ctypes.c_void_p).value or 0
        pointers = (types.uintp,) * min(arguments, 3)
        self._signature = types.void(*pointers, *(types.uint32,) * (arguments - len(pointers)))

    def __wrapper_address__(self) -> int:
        """Where the function is."""
        return self._address

    def signature(self) -> Any:
        """Its numba signature: pointers, then at most one unsigned int."""
        return self._signature


def _library() -> _Library:
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))
    arguments = {"step": 2, "forward": 2, "setState": 4, "getState": 4}
    return _Library(*(_CFunction(getattr(library, f"mj_{name}"), count) for name, count in arguments.items()))


@numba.njit(nogil=True, cache=True)
def _advance(
    library: _Library,
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
            library.set_state(model, data, state, STATE)
            if forward:
                library.forward(model, data)  # the forces of the last controls, as in the environment
            ctrl[:] = controls[row]
            for _ in range(frame_skip):
                library.step(model, data)
            library.get_state(model, data, state, STATE)
