"""The MuJoCo models of V2V, built from Meta-World's files, and where their parts are.

Importing this module imports MuJoCo, but not Meta-World: of that only the scene files are read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np

from datamodules.errors import UserError
from plp_lightning.envs.rendering.scene import HIDDEN, lighten

REACH_FILE = "sawyer_reach_v3.xml"
WINDOW_FILE = "sawyer_window_horizontal.xml"
BALLS = {"red": (0.9, 0.05, 0.05, 1.0), "green": (0.05, 0.7, 0.05, 1.0), "blue": (0.05, 0.1, 0.9, 1.0)}
"""Colour of each ball, RGBA."""
BALL_RADIUS = 0.03  # radius that is drawn, m: the balls touch nothing
UNSEEN = ("torso", "pedestal_feet", "controller_box")  # parts of the robot that are in none of our pictures
WELD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0)
"""Meta-World's weld of the hand to the point that it follows (``SawyerMocapBase.reset_mocap_welds``)."""


@dataclass(frozen=True)
class TabletopModel:
    """A compiled scene and its parts, all found by name; stepping only reads it."""

    model: mujoco.MjModel
    hand: int
    claws: tuple[int, int]
    sites: np.ndarray
    """Sites whose positions decide success: the two fingertips first, then those of the window's handle."""
    follower: int  # row in mocap_pos of the point that the hand follows
    furniture: np.ndarray  # rows in mocap_pos of what stands elsewhere in each episode: the balls, or the window
    object_qpos: slice  # place in qpos of the puck's position, or of how far the window is open
    object_qvel: slice  # speeds that are zero at the start of an episode

    @classmethod
    def of(cls, model: mujoco.MjModel, sites: Sequence[str], furniture: Sequence[str], joint: str) -> TabletopModel:
        """Find the parts by the names of sites at the object, of mocap bodies and of the object's joint."""
        tips = ("rightEndEffector", "leftEndEffector")
        qpos, qvel = int(model.joint(joint).qposadr[0]), int(model.joint(joint).dofadr[0])
        free = model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_FREE
        return cls(
            model,
            hand=model.body("hand").id,
            claws=(model.body("rightclaw").id, model.body("leftclaw").id),
            sites=np.array([model.site(name).id for name in (*tips, *sites)]),
            follower=int(model.body("mocap").mocapid[0]),
            furniture=np.array([model.body(name).mocapid[0] for name in furniture]),
            object_qpos=slice(qpos, qpos + (3 if free else 1)),
            object_qvel=slice(qvel, qvel + 6) if free else slice(0),
        )


@cache
def reach_model(image_size: int) -> TabletopModel:
    """Meta-World's Reach with coloured balls and its puck unseen, up to images ``(size, size, 3)``; built once."""
    spec = read_scene(REACH_FILE)
    for name, rgba in BALLS.items():
        ball, sphere = spec.worldbody.add_body(name=name, mocap=True), mujoco.mjtGeom.mjGEOM_SPHERE
        ball.add_geom(type=sphere, size=[BALL_RADIUS, 0, 0], rgba=rgba, contype=0, conaffinity=0, mass=0.0)
    model = _finish(spec, image_size)
    model.geom("objGeom").group[:] = HIDDEN
    return TabletopModel.of(model, sites=(), furniture=tuple(BALLS), joint="objjoint")


@cache
def window_model(image_size: int) -> TabletopModel:
    """Meta-World's window, which stands elsewhere in each episode, up to images ``(size, size, 3)``; built once."""
    spec = read_scene(WINDOW_FILE)
    # A mocap body's place is state, not model, so one model serves all episodes.
    spec.body("window").mocap = True
    handles = ("handleOpenStart", "handleCloseStart")
    return TabletopModel.of(_finish(spec, image_size), handles, furniture=("window",), joint="window_slide")


def read_scene(name: str) -> mujoco.MjSpec:
    """One of Meta-World's scenes, as shipped.

    Raises:
        UserError: If Meta-World is not installed.
    """
    package = find_spec("metaworld")
    if package is None or package.origin is None:
        raise UserError("Meta-World is not installed; V2V needs its scenes, run: pip install metaworld==3.1.1")
    return mujoco.MjSpec.from_file(str(Path(package.origin).parent / "assets" / "sawyer_xyz" / name))


def _finish(spec: mujoco.MjSpec, image_size: int) -> mujoco.MjModel:
    model = lighten(spec, UNSEEN, image_size)
    model.eq_data[:] = WELD
    return model
