"""Pictures of episodes for people: an engine's states in a model that may look better than the one that moves."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from typing import Any
from weakref import finalize

import mujoco
import numpy as np

from plp_lightning.envs.engine import Engine
from plp_lightning.envs.rendering.camera import Camera, Viewpoint


class Studio:
    """Draws episodes of an engine from one viewpoint, in the thread that first asks for a picture.

    Args:
        model: Model to draw: its joints, and its first mocap bodies, are the engine's; it may have more to see.
        viewpoint: Place of the camera.
        mirrored: Show left what is right.
    """

    def __init__(self, model: mujoco.MjModel, viewpoint: Viewpoint, mirrored: bool = False) -> None:
        self._model, self._viewpoint, self._data = model, viewpoint, mujoco.MjData(model)
        self._mirrored, self._size = mirrored, (0, 0)
        self._close: Callable[[], object] = lambda: None

    def pictures(
        self,
        engine: Engine[Any],
        rows: np.ndarray,
        size: tuple[int, int],
        arrange: Callable[[mujoco.MjData, int], object] = lambda data, row: None,
    ) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` uint8 of rows ``(n,)`` of an engine's states.

        Args:
            engine: The engine.
            rows: Episodes to draw.
            size: Height and width, pixels.
            arrange: Puts what the engine knows nothing of to its place, such as a goal, in the data of a row.

        Raises:
            UserError: If OpenGL does not work on this machine.
        """
        self._open(size)
        made = np.empty((len(rows), *size, 3), dtype=np.uint8)
        for row, picture in zip(rows, made, strict=True):
            self._place(engine, row)
            arrange(self._data, row)
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
            self._camera.image(self._data, picture)
        return made[:, :, ::-1] if self._mirrored else made

    def _open(self, size: tuple[int, int]) -> None:
        if self._size == size:
            return
        self._close()
        self._model.vis.global_.offheight, self._model.vis.global_.offwidth = size
        self._camera, self._size = Camera(self._model, self._viewpoint, size), size
        self._close = finalize(self, self._camera.close)
        atexit.register(self._close)  # before MuJoCo, which registered earlier, closes OpenGL

    def _place(self, engine: Engine[Any], row: int) -> None:
        state, data = engine.states[row], self._data
        data.qpos[:] = state[engine.qpos]
        mocap = {mujoco.mjtState.mjSTATE_MOCAP_POS: data.mocap_pos, mujoco.mjtState.mjSTATE_MOCAP_QUAT: data.mocap_quat}
        for part, places in mocap.items():
            known = state[engine.columns(part)].reshape(-1, places.shape[1])
            places[: len(known)] = known
