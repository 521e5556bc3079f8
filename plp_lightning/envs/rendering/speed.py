"""The speed of each backend on this machine."""

from __future__ import annotations

import os
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from datamodules.errors import UserError
from plp_lightning.envs.rendering.backend import Backend, missing


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
