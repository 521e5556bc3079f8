"""The OpenGL that draws images without a screen: EGL if it works here, else OSMesa; both run on the processor alone.

Importing this module imports neither MuJoCo nor OpenGL.
"""

from __future__ import annotations

import ctypes
import os
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from multiprocessing import get_context
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


def frames_per_second(backend: Backend, seconds: float = 1.0) -> float:
    """Images of V2V-Reach, ``(64, 64, 3)``, that one thread draws in a second, measured for so many ``seconds``.

    Raises:
        UserError: If the backend does not work on this machine.
    """
    # PyOpenGL settles on one backend for good, so each is asked in a process of its own.
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            return pool.submit(_draw, backend, seconds).result()
        except BrokenProcessPool as error:  # a driver that crashes takes its process with it
            raise UserError(missing(backend)) from error


def _draw(backend: Backend, seconds: float) -> float:
    os.environ["MUJOCO_GL"] = backend
    import mujoco

    from plp_lightning.envs.rendering.camera import Camera, Viewpoint
    from plp_lightning.envs.tabletop.model import reach_model
    from plp_lightning.envs.tabletop.simulator import VIEWS

    model = reach_model(64).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = Camera(model, Viewpoint(*VIEWS["front_left"]), 64)
    camera.image(data)  # the first one compiles shaders
    frames, start = 0, time.perf_counter()
    while time.perf_counter() < start + seconds:
        camera.image(data)
        frames += 1
    elapsed = time.perf_counter() - start
    camera.close()
    return frames / elapsed
