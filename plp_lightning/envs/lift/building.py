"""R2R-Lift's models out of robosuite: its Lift with a block on a pedestal, and where its parts are.

Importing it imports robosuite, which takes 50 MB, and building a model takes 300 MB more that stay taken:
:mod:`plp_lightning.envs.lift.model` runs it as a program of its own.
"""

from __future__ import annotations

import contextlib
import io
import sys
import xml.etree.ElementTree as ET
from typing import Any, cast

import mujoco
import numpy as np

from plp_lightning.envs.lift.compiling import binary, own_xml
from plp_lightning.envs.lift.robots import BUILDS, Robot
from plp_lightning.envs.lift.state import Arm
from plp_lightning.envs.lift.tasks import BLOCK_HALF, PEDESTAL_HALF
from plp_lightning.envs.suites.quiet import quiet

with quiet():
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
    with quiet():
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


def build(robot: Robot) -> bytes:
    """Compiled model and its parts, built through robosuite (2 to 5 s), as the ``npz`` file that LiftModel reads."""
    env = robosuite_env(robot)
    xml, parts = own_xml(env), env.robots[0]
    model, file = _bare_model(xml), io.BytesIO()
    np.savez(
        file,
        model=binary(model),
        xml=np.frombuffer(xml.encode(), np.uint8),
        rest_pose=np.array(parts.init_qpos, dtype=float),
        open_fingers=np.array(parts.gripper["right"].init_qpos),
        pedestal=model.body("pedestal").mocapid[0],
        **_arm(env, model, BUILDS[robot].signs)._asdict(),
    )
    return file.getvalue()


def _arm(env: Any, model: mujoco.MjModel, finger_signs: tuple[float, ...]) -> Arm:
    """Places of the robot's parts, all found by name."""
    parts = env.robots[0]
    actuators = np.array(parts._ref_actuators_indexes_dict["right"])
    finger_actuators = np.array(parts._ref_joint_gripper_actuator_indexes["right"])
    return Arm(
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
        finger_signs=np.array(finger_signs),
        finger_limits=model.actuator_ctrlrange[finger_actuators],
    )


def _bare_model(xml: str) -> mujoco.MjModel:
    """The environment's model without what only a renderer or a sensor needs; its motion is the same, bit for bit."""
    root = ET.fromstring(xml)
    for compiler in root.findall("compiler"):
        compiler.set("discardvisual", "true")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model


if __name__ == "__main__":
    with contextlib.redirect_stdout(sys.stderr):
        built = build(cast("Robot", sys.argv[1]))
    sys.stdout.buffer.write(built)
