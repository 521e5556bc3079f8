"""MuJoCo's C functions for compiled code, loaded once, and one thread's MjData as such code takes it.

Compiled code holds no lock of the interpreter, so threads that run it use all cores.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import llvmlite.binding  # type: ignore[import-untyped, unused-ignore]  # has no stubs
import mujoco
import numba
import numpy as np
from numba import types

P = ParamSpec("P")
R = TypeVar("R")

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
"""Everything of an MjData that the next step depends on, warm start, controls and mocap bodies among it."""
DIVERGED = 1e6  # a state beyond this in any coordinate has blown up, well before MuJoCo's own limit of 1e10


# Compiled code finds MuJoCo's functions by name, so that it can be cached on disk.
_names, _folder = ("libmujoco.so*", "libmujoco.*dylib", "mujoco.dll"), Path(mujoco.__file__).parent
_library = next(path for name in _names for path in sorted(_folder.glob(name)))
llvmlite.binding.load_library_permanently(str(_library))


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _say_nothing(warning: bytes) -> None:
    """Stand in the place of a handler that prints and leaves MUJOCO_LOG.TXT behind: a mask tells what diverged."""


_handler = ctypes.c_void_p.in_dll(ctypes.CDLL(str(_library)), "mju_user_warning")
_handler.value = ctypes.cast(_say_nothing, ctypes.c_void_p).value


def _c_function(name: str, *arguments: types.Type) -> Callable[..., None]:
    """A C function of MuJoCo as compiled code calls it; pointers are passed as integers."""
    return cast("Callable[..., None]", types.ExternalFunction(name, types.void(*arguments)))


_POINTER = types.intp
mj_step = _c_function("mj_step", _POINTER, _POINTER)
mj_step1 = _c_function("mj_step1", _POINTER, _POINTER)
mj_step2 = _c_function("mj_step2", _POINTER, _POINTER)
mj_forward = _c_function("mj_forward", _POINTER, _POINTER)
mj_jac_site = _c_function("mj_jacSite", _POINTER, _POINTER, _POINTER, _POINTER, types.int32)
mj_full_m = _c_function("mj_fullM", _POINTER, _POINTER, _POINTER)
_get_state = _c_function("mj_getState", _POINTER, _POINTER, _POINTER, types.uint32)
_set_state = _c_function("mj_setState", _POINTER, _POINTER, _POINTER, types.uint32)


def entry(function: Callable[P, R]) -> Callable[P, R]:
    """Compile what Python calls: without the interpreter's lock, machine code kept on disk.

    numba notices changes of the function's own file alone: after one here, delete the ``.nbi`` files of its callers.
    """
    return cast("Callable[P, R]", numba.njit(nogil=True, cache=True, error_model="numpy")(function))


def inner(function: Callable[P, R]) -> Callable[P, R]:
    """Compile what only compiled code calls: without the wrapper for Python, which costs more than the function."""
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast("Callable[P, R]", numba.njit(nogil=True, error_model="numpy", **options)(function))


class Desk(NamedTuple):
    """One thread's MjData: where it is, and what every family needs of it."""

    model: int
    data: int  # address of the MjData, as model is that of the MjModel
    ctrl: np.ndarray  # (U,): the controls that are held
    after: np.ndarray  # (S,): room for a state

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData) -> Desk:
        """Views of ``data``, controls ``(U,)``, valid as long as it lives."""
        return cls(model._address, data._address, data.ctrl, np.empty(mujoco.mj_stateSize(model, STATE)))


@inner
def sane(values: np.ndarray) -> bool:
    """True if all values ``(n,)`` are finite and of a size that physics can have."""
    for value in values:  # noqa: SIM110 - numba compiles the loop, not the generator
        if not abs(value) < DIVERGED:
            return False
    return True


@entry
def load(desk: Desk, state: np.ndarray) -> bool:
    """Put a row's state ``(S,)`` on the desk; True if it is one to go on from."""
    _set_state(desk.model, desk.data, state.ctypes.data, STATE)
    return sane(state)


@entry
def save(desk: Desk, state: np.ndarray) -> bool:
    """Make what is on the desk the row's state ``(S,)``; False if it diverged, and then the row stays as it was."""
    _get_state(desk.model, desk.data, desk.after.ctypes.data, STATE)
    if not sane(desk.after):
        return False
    state[:] = desk.after
    return True
