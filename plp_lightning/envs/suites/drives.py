"""Orders of robosuite's controllers to its arms in a control step, as compiled code takes it."""

from __future__ import annotations

from typing import Any

import numpy as np

from plp_lightning.envs.suites.torques import JOINTS, OPERATIONAL, Drive


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
    model, base = robot.sim.model, -1
    if controller.input_ref_frame == "base":
        base = int(model.site_name2id(f"{controller.naming_prefix}{controller.part_name}_center"))
    site, goal = int(model.site_name2id(controller.ref_name)), (controller.goal_pos, controller.goal_ori)
    return _made(robot, part, controller, OPERATIONAL, (site, base), goal, True)


def _joints(robot: Any, part: str, controller: Any) -> Drive | None:
    if controller.interpolator is not None:
        return None
    compensated = bool(controller.use_torque_compensation)
    return _made(robot, part, controller, JOINTS, (-1, -1), (controller.goal_qpos, np.eye(3)), compensated)


def _made(
    robot: Any,
    part: str,
    controller: Any,
    law: int,
    sites: tuple[int, int],
    goal: tuple[np.ndarray, np.ndarray],
    compensated: bool,
) -> Drive:
    model, actuators = robot.sim.model, np.array(robot._ref_actuators_indexes_dict[part], np.int64)
    body = model.site_bodyid[sites[1]] if sites[1] >= 0 else 0
    return Drive(
        law=law,
        site=sites[0],
        base=sites[1],
        moving=bool(model.body_weldid[body] != 0),
        qpos=np.array(controller.qpos_index, np.int64),
        dof=np.array(controller.qvel_index, np.int64),
        actuators=actuators,
        limits=np.ascontiguousarray(model.actuator_ctrlrange[actuators], np.float64),
        stiffness=np.array(controller.kp, np.float64),
        damping=np.array(controller.kd, np.float64),
        position=np.array(goal[0], np.float64),
        rotation=np.ascontiguousarray(goal[1], np.float64),
        rest=np.array(controller.initial_joint, np.float64),
        compensated=compensated,
    )
