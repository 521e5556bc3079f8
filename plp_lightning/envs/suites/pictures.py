"""Pictures of a world from the library's own cameras, drawn from a lighter model of the same bodies."""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from weakref import finalize

import mujoco
import numpy as np

from plp_lightning.envs.rendering.camera import Camera
from plp_lightning.envs.rendering.scene import HIDDEN, lighten
from plp_lightning.envs.suites.world import World

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])  # half a turn about the direction of view, as a quaternion


class Pictures:
    """Draws what a world holds.

    Args:
        world: What is drawn.
        cameras: Cameras of the observations.
        size: Height and width of their images, pixels.
    """

    def __init__(self, world: World, cameras: Sequence[str], size: int) -> None:
        self._size = (0, 0)
        light = upright(_seen(lighten(world.scene(), (), size), world.colliding)) if cameras else None
        self._views = [_Drawing(light, camera, (size, size)) for camera in cameras] if light is not None else []

    def images(self, world: World) -> list[np.ndarray]:
        """An image ``(H, W, 3)`` of each camera."""
        return [view.of(world) for view in self._views]

    def film(self, world: World, camera: str, size: tuple[int, int]) -> np.ndarray:
        """A picture ``(H, W, 3)`` of any size, pixels."""
        if self._size != size:
            model = upright(_seen(world.scene().compile(), world.colliding))
            model.vis.quality.offsamples = 0  # smooth edges would take more than twice the time
            model.vis.global_.offheight, model.vis.global_.offwidth = size
            self._film, self._size = _Drawing(model, camera, size), size
        return self._film.of(world)


class _Drawing:
    """One camera's drawings of a model whose bodies are a world's."""

    def __init__(self, model: mujoco.MjModel, camera: str, size: tuple[int, int]) -> None:
        self._model, self._data, self._camera = model, mujoco.MjData(model), Camera(model, camera, size)
        atexit.register(finalize(self, self._camera.close))  # before MuJoCo, which registered earlier, closes OpenGL

    def of(self, world: World) -> np.ndarray:
        model, data = self._model, self._data
        model.body_pos[:], model.body_quat[:] = world.model.body_pos, world.model.body_quat
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = (
            world.data.qpos, world.data.mocap_pos, world.data.mocap_quat,
        )  # fmt: skip
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        return self._camera.image(data)


def upright(model: mujoco.MjModel) -> mujoco.MjModel:
    """Turn cameras that are shipped upside down, in place: those whose upward direction points down in the world."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for camera in np.flatnonzero(data.cam_xmat[:, 7] < -0.1):  # z of the second axis, which points up in the image
        turned = np.empty(4)
        mujoco.mju_mulQuat(turned, model.cam_quat[camera], UPRIGHT)
        model.cam_quat[camera] = turned
    return model


def _seen(model: mujoco.MjModel, colliding: int | None) -> mujoco.MjModel:
    """Hide, in place, all sites, which mark goals and handles, and what is there to collide alone."""
    if colliding is not None:
        model.geom_group[model.geom_group == colliding] = HIDDEN
    model.site_group[:] = HIDDEN
    return model
