"""What robosuite's controllers want of its arms in a control step, as compiled code takes it."""

from __future__ import annotations

from typing import Any

import numpy as np

from plp_lightning.envs.suites.torques import JOINTS, OPERATIONAL, Drive

NONE = np.zeros(0)


def drives(env: Any) -> tuple[Drive, ...] | None:
    """A drive of each arm, once their goals are set; None if a part moves by a law that is not compiled.

    Grippers hold a control for the whole control step, and need nothing.
    """
    found = []
    for robot in env.robots:
        for part, controller in robot.composite_controller.part_controllers.items():
            if part in robot.composite_controller.grippers:
                continue
            drive = _drive(robot, part, controller)
            if drive is None or type(robot).__name__ != "FixedBaseRobot":
                return None
            found.append(drive)
    return tuple(found)


def _drive(robot: Any, part: str, controller: Any) -> Drive | None:
    law = {"OSC_POSE": _hand, "OSC_POSITION": _hand, "JOINT_POSITION": _joints}.get(controller.name)
    return None if law is None else law(robot, part, controller)


def _hand(robot: Any, part: str, controller: Any) -> Drive | None:
    if not controller.uncoupling or controller.interpolator_pos is not None or controller.interpolator_ori is not None:
        return None
    position, rotation = controller.goal_pos, controller.goal_ori
    if controller.input_ref_frame == "base":
        position = controller.origin_pos + controller.origin_ori @ position
        rotation = controller.origin_ori @ rotation
    site = robot.sim.model.site_name2id(controller.ref_name)
    return _made(robot, part, controller, OPERATIONAL, int(site), position, rotation, True)


def _joints(robot: Any, part: str, controller: Any) -> Drive | None:
    if controller.interpolator is not None:
        return None
    compensated = bool(controller.use_torque_compensation)
    return _made(robot, part, controller, JOINTS, -1, controller.goal_qpos, np.eye(3), compensated)


def _made(
    robot: Any, part: str, controller: Any, law: int, site: int, goal: np.ndarray, turn: np.ndarray, compensated: bool
) -> Drive:
    actuators = np.array(robot._ref_actuators_indexes_dict[part], np.int64)
    numbers = (controller.kp, controller.kd, goal)
    stiffness, damping, position = (np.array(part, np.float64) for part in numbers)
    return Drive(
        law,
        site,
        np.array(controller.qpos_index, np.int64),
        np.array(controller.qvel_index, np.int64),
        actuators,
        np.ascontiguousarray(robot.sim.model.actuator_ctrlrange[actuators], np.float64),
        stiffness,
        damping,
        position,
        np.ascontiguousarray(turn, np.float64),
        np.array(controller.initial_joint, np.float64),
        compensated,
    )
