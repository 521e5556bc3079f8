"""The OpenGL that draws images without a screen: EGL if it works here, else OSMesa; both run on the processor alone.

Importing this module imports neither MuJoCo nor OpenGL.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from typing import Literal, get_args

from datamodules.errors import UserError

Backend = Literal["egl", "osmesa"]

PACKAGES: dict[Backend, str] = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""Packages of Debian and Ubuntu that a backend needs."""

_PLATFORM_DEVICE, _MOST_DEVICES = 0x313F, 16  # the first is EGL_PLATFORM_DEVICE_EXT


def choose_backend() -> Backend:
    """The backend to draw with, also left in ``MUJOCO_GL`` for imports of MuJoCo later.

    A value that ``MUJOCO_GL`` has already is taken as it is. Call this before MuJoCo is imported if
    ``mujoco.Renderer`` is to be used too; :class:`~plp_lightning.envs.rendering.camera.Camera` works in any order.

    Raises:
        UserError: If ``MUJOCO_GL`` names a backend that needs a screen, or nothing works.
    """
    _keep_to_calling_threads()
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    for backend in get_args(Backend):
        if wanted == backend or (not wanted and works(backend)):
            os.environ["MUJOCO_GL"] = backend
            chosen: Backend = backend
            return chosen
    if wanted:
        raise UserError(f"MUJOCO_GL is {wanted!r}; expected {' or '.join(PACKAGES)}, or unset it to let plp choose")
    raise UserError(missing("egl"))


def check_backend() -> None:
    """Refuse, by a :class:`UserError`, a machine on which the backend that is chosen, or named, does not work."""
    if not works(backend := choose_backend()):
        raise UserError(missing(backend))


def missing(backend: Backend) -> str:
    """One line: images cannot be drawn with ``backend``, and the packages to install."""
    return (
        f"images cannot be drawn: {backend} does not work on this machine; "
        f"expected Mesa's libraries, install them: apt-get install {PACKAGES[backend]}"
    )


@cache
def works(backend: Backend) -> bool:
    """True if the backend's library is there and, for EGL, a device that can be initialised."""
    _keep_to_calling_threads()
    try:
        if backend == "osmesa":
            return bool(ctypes.CDLL("libOSMesa.so.8"))
        return _egl_initialises(ctypes.CDLL("libEGL.so.1"))
    except OSError:
        return False


def _keep_to_calling_threads() -> None:
    """Tell Mesa, which asks when it is first used, to draw in the thread that calls: its own would fight for cores."""
    os.environ.setdefault("LP_NUM_THREADS", "0")


def _egl_initialises(egl: ctypes.CDLL) -> bool:
    """True if any device of EGL can be initialised, asked as MuJoCo does, but before PyOpenGL settles on EGL."""
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    pointer, number = ctypes.c_void_p, ctypes.c_int32
    addresses = [egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")]
    if not all(addresses):
        return False
    query = ctypes.CFUNCTYPE(number, number, pointer, pointer)(addresses[0])
    display_of = ctypes.CFUNCTYPE(pointer, number, pointer, pointer)(addresses[1])
    devices, count = (pointer * _MOST_DEVICES)(), number(0)
    if not query(_MOST_DEVICES, ctypes.addressof(devices), ctypes.addressof(count)):
        return False
    displays = (display_of(_PLATFORM_DEVICE, device, None) for device in devices[: count.value])
    return any(display and egl.eglInitialize(pointer(display), None, None) for display in displays)
