"""A camera that draws a model's states as small images, without a screen, shadows and reflections."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import mujoco
import numpy as np

from datamodules.errors import UserError
from plp_lightning.envs.rendering.backend import choose_backend, missing

_OFF = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION)


class Viewpoint(NamedTuple):
    """Place of a camera, and the point that it looks at."""

    azimuth: float  # direction of the view around the vertical, degrees; 90 looks along +y
    elevation: float  # direction of the view against the horizon, degrees; negative looks down
    distance: float  # from the point looked at, m
    lookat: tuple[float, float, float] = (0.0, 0.7, 0.15)  # in the world, m


class Camera:
    """Draws states of one model from one viewpoint.

    Its OpenGL context belongs to the thread that makes the camera: only that thread may use it or let it go.

    Args:
        model: Model to draw; its offscreen buffer decides the largest image.
        viewpoint: Place of the camera, or the name of one of the model's own.
        size: Height and width of the images, pixels; one number for both if they are square.

    Raises:
        UserError: If the chosen backend does not work on this machine.
    """

    def __init__(self, model: mujoco.MjModel, viewpoint: Viewpoint | str, size: int | tuple[int, int]) -> None:
        height, width = (size, size) if isinstance(size, int) else size
        self._model, self._context = model, _make_context(width, height)
        self._context.make_current()
        model.vis.quality.shadowsize = 0  # room for shadows, which nobody draws, would be 64 MB
        self._drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + 100)
        for flag in _OFF:
            self._scene.flags[flag] = 0
        self._option = mujoco.MjvOption()
        self._camera = fixed_camera(model, viewpoint) if isinstance(viewpoint, str) else free_camera(viewpoint)
        self._frame = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)

    def image(self, data: mujoco.MjData, out: np.ndarray | None = None) -> np.ndarray:
        """The state in ``data``, whose kinematics are fresh, as uint8 ``(H, W, 3)``, top row first.

        It is written to ``out``, of that shape too, or to a new array.
        """
        out = np.empty_like(self._pixels) if out is None else out
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, everything, self._scene)
        self._context.make_current()
        mujoco.mjr_render(self._frame, self._scene, self._drawing)
        mujoco.mjr_readPixels(self._pixels, None, self._frame, self._drawing)
        out[:] = self._pixels[::-1]  # OpenGL counts rows from below
        return out

    def close(self) -> None:
        """Give the context back; the camera cannot be used any more."""
        self._drawing.free()
        self._context.free()


def free_camera(viewpoint: Viewpoint) -> mujoco.MjvCamera:
    """MuJoCo's free camera at a viewpoint."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = viewpoint.lookat
    camera.azimuth, camera.elevation, camera.distance = viewpoint[:3]
    return camera


def fixed_camera(model: mujoco.MjModel, name: str) -> mujoco.MjvCamera:
    """A model's own camera of that name."""
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(name).id
    return camera


def _make_context(width: int, height: int) -> Any:
    """An OpenGL context of the chosen backend, taken from its own module: it may be chosen after MuJoCo's import."""
    backend = choose_backend()
    try:
        return importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
    except Exception as error:  # PyOpenGL's errors have nothing else in common
        raise UserError(missing(backend)) from error
