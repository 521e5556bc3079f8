"""The speed of each backend on this machine."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from datamodules.errors import UserError
from plp_lightning.envs.rendering.backend import Backend, missing

LIMIT = 120  # s after which a driver that hangs is given up


def frames_per_second(backend: Backend, seconds: float = 1.0) -> float:
    """Images of V2V-Reach, ``(64, 64, 3)``, that one thread draws in a second, measured for so many ``seconds``.

    Raises:
        UserError: If the backend, or MuJoCo, does not work on this machine.
    """
    # PyOpenGL settles on one backend for good, so each is asked in a process of its own.
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            answer = pool.submit(_measured, backend, seconds).result()
        except BrokenProcessPool as error:  # a driver that crashes or hangs takes its process with it
            raise UserError(missing(backend)) from error
    if isinstance(answer, str):
        raise UserError(answer)
    return answer


def _measured(backend: Backend, seconds: float) -> float | str:
    """Frames per second, or why there are none: errors of a broken package may not reach another process whole."""
    if hasattr(signal, "alarm"):
        signal.alarm(LIMIT)
    try:
        return _draw(backend, seconds)
    except ModuleNotFoundError as error:
        return f"images cannot be drawn: {error}; install what is missing: pip install -e '.[sim]'"
    except Exception as error:  # MuJoCo and PyOpenGL raise what they like where a library is missing
        return f"{missing(backend)} ({type(error).__name__}: {' '.join(str(error).split())[:200]})"


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
