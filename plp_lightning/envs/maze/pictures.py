"""Pictures of bodies in mazes, from above and a little from the side, with the goal on the floor."""

from __future__ import annotations

import mujoco
import numpy as np

from plp_lightning.envs.maze.layout import Frame
from plp_lightning.envs.rendering.camera import Viewpoint
from plp_lightning.envs.rendering.studio import Studio

FLOOR, WALL, BODY, GOAL = (
    *((0.96, 0.96, 0.96, 1.0), (0.5, 0.53, 0.57, 1.0)),
    *((0.0, 0.45, 0.7, 1.0), (0.0, 0.62, 0.45, 1.0)),
)
THICKNESS = 0.01  # of the disc that marks the goal, m
ELEVATION = -80.0  # degrees
LOW = 0.15  # half height of a wall for each metre of half its width: nothing hides behind it
WIDTH = 1.3  # distance of the camera for each metre of the maze, m: MuJoCo's free camera sees an angle of 45°


def maze_studio(mjcf: str, frame: Frame, shape: tuple[int, int], radius: float) -> Studio:
    """A studio for a body in a maze of so many rows and columns, whose one mocap body marks the goal by its ``radius``.

    Rows go down the pictures, columns to the right, as in :class:`~plp_lightning.envs.views.FloorPlan`; where the frame
    is of the other hand, that takes a mirror.
    """
    spec = mujoco.MjSpec.from_string(mjcf)
    for geom in spec.geoms:
        geom.rgba = FLOOR if geom.name == "floor" else WALL if geom.name.startswith("wall_") else BODY
        if geom.name.startswith("wall_"):
            geom.size[2] = geom.pos[2] = LOW * geom.size[0]
    disc = spec.worldbody.add_body(name="goal", mocap=True)
    disc.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius, THICKNESS, 0], rgba=GOAL)
    _light(spec)
    up, right = -np.array(frame.down), np.array(frame.right)
    middle = frame.centres((np.array(shape) - 1) / 2)
    distance = WIDTH * float(np.linalg.norm(up)) * max(shape)
    azimuth = float(np.degrees(np.arctan2(up[1], up[0])))
    view = Viewpoint(azimuth, ELEVATION, distance, (float(middle[0]), float(middle[1]), 0.0))
    return Studio(spec.compile(), view, mirrored=bool(up[1] * right[0] - up[0] * right[1] < 0))


def _light(spec: mujoco.MjSpec) -> None:
    """Light all mazes alike, walls and floor apart."""
    for light in list(spec.lights):
        light.delete()
    spec.worldbody.add_light(directional=True, dir=[0.3, 0.4, -1.0], diffuse=[0.5] * 3, specular=[0.0] * 3)
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0.0] * 3
    spec.visual.headlight.specular = [0.0] * 3
