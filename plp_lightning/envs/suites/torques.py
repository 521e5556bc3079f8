"""robosuite's arm controllers without Python: of a control step, all physics steps but the first are one compiled call.

The laws are robosuite 1.5's (https://robosuite.ai/docs/modules/controllers.html). What an action means, and so the
goals, is left to the library, which takes the first physics step itself. :mod:`plp_lightning.envs.lift.osc` has the
equations of operational space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plp_lightning.envs.lift.osc import REST_DAMPING, REST_STIFFNESS, combine, product
from plp_lightning.envs.lift.state import Workspace
from plp_lightning.envs.native import entry, inner, mj_full_m, mj_jac_site, mj_step1, mj_step2, sane

OPERATIONAL, JOINTS = 0, 1  # laws: of the hand's pose, of the joints' angles


class Drive(NamedTuple):
    """Orders of a controller to an arm with n joints in a control step."""

    law: int  # OPERATIONAL or JOINTS
    site: int  # the hand, for the former, as is base: in whose frame the goal stands still
    base: int
    moving: bool  # whether the base moves
    qpos: np.ndarray  # (n,) places of the joints, as are dof and actuators
    dof: np.ndarray
    actuators: np.ndarray
    limits: np.ndarray  # (n, 2) least and greatest control
    stiffness: np.ndarray  # (6,) or (n,), as is damping
    damping: np.ndarray
    position: np.ndarray  # (3,) goal of the hand, m, from its base; or (n,) of the joints, rad
    rotation: np.ndarray  # (3, 3) goal of the hand, from its base
    rest: np.ndarray  # (n,) posture to which motion that the hand does not feel is drawn, rad
    compensated: bool  # whether joints' torques are those of accelerations, and gravity is added


@inner
def twist(work: Workspace, site: int) -> np.ndarray:
    """Velocity ``(6, 1)`` of a site, linear above angular, whose Jacobian stays in the workspace."""
    linear, angular = work.jacobian[:3], work.jacobian[3:]
    mj_jac_site(work.desk.model, work.desk.data, linear.ctypes.data, angular.ctypes.data, site)
    return product(work.jacobian, work.qvel.reshape(-1, 1))


@inner
def error(arm: Drive, work: Workspace) -> np.ndarray:
    """Way ``(6, 1)`` of the hand to its goal: m above rad."""
    far, frame = np.zeros((6, 1)), np.eye(3)
    if arm.base >= 0:
        frame[:] = work.site_rotation[arm.base].reshape(3, 3)
    position, wanted = product(frame, arm.position.reshape(3, 1)), product(frame, arm.rotation)
    rotation = work.site_rotation[arm.site].reshape(3, 3)
    for axis in range(3):
        far[axis, 0] = position[axis, 0] - work.site_pos[arm.site, axis]
        if arm.base >= 0:
            far[axis, 0] += work.site_pos[arm.base, axis]
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for column in range(3):
            turn = rotation[a, column] * wanted[b, column] - rotation[b, column] * wanted[a, column]
            far[3 + axis, 0] += 0.5 * turn
    return far


@inner
def hand_torques(arm: Drive, work: Workspace, mass: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Torques ``(n, 1)`` that draw the hand to its goal."""
    pull = error(arm, work)
    velocity = -twist(work, arm.base) if arm.moving else np.zeros((6, 1))
    velocity += twist(work, arm.site)
    for i in range(6):
        pull[i, 0] = arm.stiffness[i] * pull[i, 0] - arm.damping[i] * velocity[i, 0]
    away = (arm.rest - work.qpos[arm.qpos]).reshape(-1, 1)
    return combine(mass, work.jacobian[:, arm.dof], pull, REST_STIFFNESS * away - REST_DAMPING * speed)


@inner
def joint_torques(arm: Drive, work: Workspace, mass: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Torques ``(n, 1)`` that draw the joints to their goals."""
    away = arm.position - work.qpos[arm.qpos]
    wanted = (arm.stiffness * away - arm.damping * speed[:, 0]).reshape(-1, 1)
    return product(mass, wanted) if arm.compensated else wanted


@inner
def drive(arm: Drive, work: Workspace) -> None:
    """Write the controls of an arm, clipped to its limits."""
    mass, speed = work.mass[arm.dof][:, arm.dof], work.qvel[arm.dof].reshape(-1, 1)
    by_hand = arm.law == OPERATIONAL
    torque = hand_torques(arm, work, mass, speed) if by_hand else joint_torques(arm, work, mass, speed)
    for i in range(len(arm.actuators)):
        found = torque[i, 0] + (work.bias[arm.dof[i]] if arm.compensated else 0.0)
        work.desk.ctrl[arm.actuators[i]] = min(max(found, arm.limits[i, 0]), arm.limits[i, 1])


@entry
def hold(work: Workspace, arms: tuple[Drive, ...], substeps: int) -> bool:
    """Take so many physics steps, driving all arms; False if they diverge. What else is controlled stays as it is."""
    desk = work.desk
    for _ in range(substeps):
        if not (sane(work.qpos) and sane(work.qvel)):
            return False
        mj_step1(desk.model, desk.data)
        mj_full_m(desk.model, work.mass.ctypes.data, work.inertia.ctypes.data)
        for arm in arms:
            drive(arm, work)
        mj_step2(desk.model, desk.data)
    return True
