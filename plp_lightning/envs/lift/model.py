"""The MuJoCo model of R2R-Lift, and where its parts are: built once for all runs of a user, without robosuite here."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from plp_lightning.envs.apart import run_apart
from plp_lightning.envs.kept import kept, origin
from plp_lightning.envs.lift.robots import Robot
from plp_lightning.envs.lift.state import Arm
from plp_lightning.envs.rendering.scene import HIDDEN

COLLIDING = 0  # robosuite's group of geoms that collide; those to be seen are in another


@dataclass(frozen=True)
class LiftModel:
    """A compiled model and its parts, all found by name."""

    model: mujoco.MjModel
    arm: Arm
    rest_pose: np.ndarray  # arm joints (n,) in robosuite's initial pose, rad; open_fingers (g,) likewise, m or rad
    open_fingers: np.ndarray
    pedestal: int  # row of the pedestal in mocap_pos
    xml: str  # robosuite's own file, with all that is there to be seen

    @classmethod
    @cache
    def build(cls, robot: Robot) -> LiftModel:
        """The robot's model, one in a process: stepping only reads it. It is kept on disk once it was built (8 s)."""
        content = kept(f"lift_{robot}_{origin('robosuite', Path(__file__).parent)}.npz", partial(_built_apart, robot))
        with np.load(io.BytesIO(content)) as file:
            parts: dict[str, Any] = {name: file[name] if file[name].ndim else int(file[name]) for name in file.files}
        model = _read(parts["model"].tobytes())
        arm, xml = Arm(**{name: parts[name] for name in Arm._fields}), parts["xml"].tobytes().decode()
        return cls(model, arm, parts["rest_pose"], parts["open_fingers"], parts["pedestal"], xml)

    def visible(self) -> mujoco.MjModel:
        """A model of the same joints for pictures, with meshes and textures in the place of what collides."""
        content = _apart("compiling", given=self.xml.encode())
        model = mujoco.MjModel.from_xml_string(self.xml) if content is None else _read(content)
        model.geom_group[model.geom_group == COLLIDING] = model.site_group[:] = HIDDEN
        model.vis.quality.offsamples = 0  # smooth edges would take more than twice the time
        return model


def _read(content: bytes) -> mujoco.MjModel:
    return mujoco.MjModel.from_binary_path("lift.mjb", {"lift.mjb": content})


def _built_apart(robot: Robot) -> bytes:
    """A robot's model from a process of its own."""
    content = _apart("building", robot)
    if content is None:
        from plp_lightning.envs.lift.building import build

        return build(robot)
    return content


def _apart(module: str, *words: str, given: bytes = b"") -> bytes | None:
    """Bytes that a module of Lift makes of words and bytes in a process of its own; None if that fails.

    robosuite and MuJoCo's compiler leave hundreds of MB behind, which are given back so. Whatever is amiss is told
    better where it is met again; and it may have been the process alone.
    """
    try:
        done = run_apart(f"lift.{module}", *words, given=given)
    except OSError:
        return None
    return None if done.returncode else done.stdout
