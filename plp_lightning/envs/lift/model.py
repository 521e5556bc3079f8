"""The MuJoCo model of R2R-Lift: robosuite's Lift with a block on a pedestal, and where its parts are.

Importing it imports robosuite; :mod:`plp_lightning.envs.lift.simulator` does so at the first reset only.
"""

from __future__ import annotations

import logging
import os
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np

from plp_lightning.envs.lift.state import Arm
from plp_lightning.envs.lift.tasks import BLOCK_HALF, Robot
from plp_lightning.envs.rendering.scene import HIDDEN

PEDESTAL_HALF = (0.018, 0.018, 0.10)
"""Half size of the pedestal, m: narrower than the block, so that the fingers clear it."""
ARENA = "16M"  # room for contacts in each thread; an episode needs less than a tenth of it
COLLIDING = 0  # robosuite's group of geoms that collide; those to be seen are in another
FINGERS = {"Sawyer": (1.0, -1.0), "UR5e": (1.0, 1.0)}
"""Sign with which each finger's actuator follows the gripper command."""


@contextmanager
def _quiet() -> Iterator[None]:
    """Let robosuite neither print nor leave the rendering backend it prefers in the environment."""
    logger, backend = logging.getLogger("robosuite_logs"), os.environ.get("MUJOCO_GL")
    disabled, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = disabled
        os.environ.pop("MUJOCO_GL", None)
        if backend is not None:
            os.environ["MUJOCO_GL"] = backend


with _quiet():
    from robosuite.controllers import load_composite_controller_config
    from robosuite.environments.manipulation.lift import Lift as RobosuiteLift


class PedestalLift(RobosuiteLift):  # type: ignore[misc, unused-ignore]  # robosuite is untyped
    """robosuite's Lift with a block of one size that stands on a movable pedestal.

    The pedestal is a mocap body: its height is state, not model, so one model serves all tasks. It sinks into the
    table unhindered, since MuJoCo never collides two static bodies.
    """

    def _load_model(self) -> None:
        super()._load_model()
        pedestal = ET.SubElement(self.model.worldbody, "body", name="pedestal", mocap="true", pos="0 0 0.7")
        size, friction = (" ".join(map(str, numbers)) for numbers in (PEDESTAL_HALF, self.table_friction))
        ET.SubElement(pedestal, "geom", name="pedestal_g", type="box", size=size, friction=friction, group="1")
        geoms = {geom.get("name"): geom for geom in self.model.root.iter("geom")}
        for name in ("cube_g0", "cube_g0_vis"):
            geoms[name].set("size", " ".join([str(BLOCK_HALF)] * 3))
        # Sawyer's base is welded to the world, so nothing filters its contact with the first link, whose
        # friction then freezes joint 0.
        if "robot0_base_col" in geoms:
            geoms["robot0_base_col"].attrib.update(contype="0", conaffinity="0")


def robosuite_env(robot: Robot, joint_noise: float = 0.0) -> Any:
    """A robosuite environment of the task, controlled in position at 20 Hz, without any renderer; noise is in rad."""
    with _quiet():
        controller = load_composite_controller_config(controller="BASIC", robot=robot)
        arm = controller["body_parts"]["right"]
        arm.update(type="OSC_POSITION", input_max=1, input_min=-1, output_max=[0.05] * 3, output_min=[-0.05] * 3)
        return PedestalLift(
            robots=robot,
            controller_configs=controller,
            initialization_noise={"type": "gaussian", "magnitude": joint_noise},
            use_camera_obs=False,
            has_offscreen_renderer=False,
            renderer="mujoco",
            hard_reset=False,
            ignore_done=True,
            control_freq=20,
        )


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
        """The robot's model, built through robosuite (2 to 5 s) once in a process: stepping only reads it."""
        env = robosuite_env(robot)
        xml = _own_xml(env)
        parts, model = env.robots[0], _bare_model(xml)
        actuators = np.array(parts._ref_actuators_indexes_dict["right"])
        finger_actuators = np.array(parts._ref_joint_gripper_actuator_indexes["right"])
        arm = Arm(
            site=int(parts.eef_site_id["right"]),
            hand=int(model.body(parts.robot_model.eef_name["right"]).id),
            block=int(model.joint(env.cube.joints[0]).qposadr[0]),
            qpos=np.array(parts._ref_joint_pos_indexes),
            dof=np.array(parts._ref_joint_vel_indexes),
            actuators=actuators,
            limits=model.actuator_ctrlrange[actuators],
            finger_qpos=np.array(parts._ref_gripper_joint_pos_indexes["right"]),
            finger_dof=np.array(parts._ref_gripper_joint_vel_indexes["right"]),
            finger_actuators=finger_actuators,
            finger_signs=np.array(FINGERS[robot]),
            finger_limits=model.actuator_ctrlrange[finger_actuators],
        )
        rest_pose, fingers = np.array(parts.init_qpos, dtype=float), np.array(parts.gripper["right"].init_qpos)
        return cls(model, arm, rest_pose, fingers, int(model.body("pedestal").mocapid[0]), xml)

    def visible(self) -> mujoco.MjModel:
        """A model of the same joints for pictures, with meshes and textures in the place of what collides."""
        model = mujoco.MjModel.from_xml_string(self.xml)
        model.geom_group[model.geom_group == COLLIDING] = model.site_group[:] = HIDDEN
        model.vis.quality.offsamples = 0  # smooth edges would take more than twice the time
        return model


def _own_xml(env: Any) -> str:
    root = ET.fromstring(env.edit_model_xml(env.model.get_xml()))
    for size in root.findall("size"):  # robosuite asks for room for thousands of contacts: a gigabyte in each thread
        root.remove(size)
    ET.SubElement(root, "size", memory=ARENA)
    return ET.tostring(root, encoding="unicode")


def _bare_model(xml: str) -> mujoco.MjModel:
    """The environment's model without what only a renderer or a sensor needs; its motion is the same, bit for bit."""
    root = ET.fromstring(xml)
    for compiler in root.findall("compiler"):
        compiler.set("discardvisual", "true")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model
