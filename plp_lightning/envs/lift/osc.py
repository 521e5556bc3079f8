"""Operational-space control without Python: a control step of an episode, physics and all, is one compiled call.

The control law is robosuite 1.5's position controller (https://robosuite.ai/docs/modules/controllers.html), after
O. Khatib, "A unified approach for motion and force control of robot manipulators: the operational space formulation",
IEEE J. Robotics and Automation 3(1), 1987. With M the inertia of the arm, J the Jacobian of the hand, F the wanted
acceleration of the hand, u that of the joints towards their posture, and g the bias force, a step computes

1. ``L = (J M^-1 J')^-1``, the inertia that the hand feels, and ``Lv``, ``Lw`` of the linear and angular halves of J;
2. ``F = kp (x_goal - x) - kd J q'``, for the position and, likewise, for the orientation;
3. ``tau = J' [Lv F_v; Lw F_w]``, force and torque decoupled as robosuite does;
4. ``tau += (1 - J' L J M^-1) M u``, the posture in the null space, where the hand does not feel it;
5. ``tau += g``, gravity and Coriolis forces.
"""

from __future__ import annotations

import numpy as np

from plp_lightning.envs.lift.state import Arm, Episodes, Workspace
from plp_lightning.envs.native import (
    entry,
    inner,
    load,
    mj_forward,
    mj_full_m,
    mj_jac_site,
    mj_step1,
    mj_step2,
    sane,
    save,
)

SUBSTEPS = 25  # physics steps in one control step: 20 Hz over 2 ms
REACH = 0.05  # way of the goal for an action of 1, m
STIFFNESS = 150.0
DAMPING = 2.0 * STIFFNESS**0.5
REST_STIFFNESS = 10.0
REST_DAMPING = 2.0 * REST_STIFFNESS**0.5
GRIPPER_SPEED = 0.2  # change of the gripper's command in one control step; it runs from -1, open, to 1, closed
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # orientation that the hand keeps: fingers down


@inner
def solve(matrix: np.ndarray, right: np.ndarray) -> None:
    """Solve ``matrix @ x = right`` ``(n, k)`` in place, by Cholesky's method: the matrix is positive definite."""
    size, columns = right.shape
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            # At a singular pose rounding may leave a pivot below zero.
            matrix[i, j] = np.sqrt(max(rest, 1e-15)) if i == j else rest / matrix[j, j]
    for c in range(columns):
        for i in range(size):  # forwards: C y = right, with the factor C
            for k in range(i):
                right[i, c] -= matrix[i, k] * right[k, c]
            right[i, c] /= matrix[i, i]
        for i in range(size - 1, -1, -1):  # backwards: C' x = y
            for k in range(i + 1, size):
                right[i, c] -= matrix[k, i] * right[k, c]
            right[i, c] /= matrix[i, i]


@inner
def wrench(arm: Arm, work: Workspace, goal: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Spring and damper ``(6, 1)``, force above torque, from a hand with velocity ``(6, 1)`` to its goal ``(3,)``."""
    pull = np.zeros((6, 1))
    rotation = work.site_rotation[arm.site].reshape(3, 3)
    for axis in range(3):
        pull[axis, 0] = goal[axis] - work.site_pos[arm.site, axis]  # x_goal - x
        a, b = (axis + 1) % 3, (axis + 2) % 3
        # Orientation error: 1/2 sum_c r_c x d_c, cross products of the actual axes r and the wanted axes d.
        for column in range(3):
            turn = rotation[a, column] * DOWN[b, column] - rotation[b, column] * DOWN[a, column]
            pull[3 + axis, 0] += 0.5 * turn
    pull *= STIFFNESS
    pull -= DAMPING * velocity  # F = kp error - kd J q', equation 2
    return pull


@inner
def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Product ``(n, k)`` of ``(n, m)`` and ``(m, k)``; for matrices this small a loop is faster than a call of BLAS."""
    out = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for k in range(left.shape[1]):
            for j in range(right.shape[1]):
                out[i, j] += left[i, k] * right[k, j]
    return out


@inner
def torques(arm: Arm, work: Workspace, goal: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Joint torques ``(n, 1)`` in N m, not yet clipped, for a goal ``(3,)`` in m and a posture ``(n,)`` in rad."""
    # M of the whole scene from MuJoCo's sparse form, and J of the hand; both are then cut down to the arm's joints.
    mj_full_m(work.desk.model, work.mass.ctypes.data, work.inertia.ctypes.data)
    linear, angular = work.jacobian[:3], work.jacobian[3:]
    mj_jac_site(work.desk.model, work.desk.data, linear.ctypes.data, angular.ctypes.data, arm.site)
    mass, jacobian = work.mass[arm.dof][:, arm.dof], work.jacobian[:, arm.dof]
    speed, away = work.qvel[arm.dof].reshape(-1, 1), (rest - work.qpos[arm.qpos]).reshape(-1, 1)
    posture = REST_STIFFNESS * away - REST_DAMPING * speed  # u = kp (q_rest - q) - kd q'
    total = combine(mass, jacobian, wrench(arm, work, goal, product(jacobian, speed)), posture)
    total[:, 0] += work.bias[arm.dof]  # tau += g, equation 5
    return total


@inner
def combine(mass: np.ndarray, jacobian: np.ndarray, pull: np.ndarray, posture: np.ndarray) -> np.ndarray:
    """Torques ``(n, 1)`` of the task, and of the posture where the hand does not feel it.

    Equations 3 and 4 together: the posture torque ``N' M u`` of the null space ``N = 1 - M^-1 J' L J`` is
    ``M u - J' L J u``, so that both go through ``J'`` at once and no inverse of M or L is formed.

    Args:
        mass: Inertia M of the arm ``(n, n)``; overwritten.
        jacobian: J of the hand ``(6, n)``, linear above angular.
        pull: Wanted acceleration of the hand ``(6, 1)``; overwritten.
        posture: Wanted acceleration u of the joints ``(n, 1)``.
    """
    held = product(mass, posture)  # M u, while M is whole
    flexible = jacobian.T.copy()
    solve(mass, flexible)  # M^-1 J'
    mobility = product(jacobian, flexible)  # L^-1 = J M^-1 J', equation 1
    unwanted = product(jacobian, posture)  # J u, how the hand would feel the posture
    solve(mobility[:3, :3].copy(), pull[:3])  # Lv F_v, from the diagonal blocks of L^-1
    solve(mobility[3:, 3:].copy(), pull[3:])  # Lw F_w
    solve(mobility, unwanted)  # L J u
    pull -= unwanted
    held += product(jacobian.T, pull)  # M u + J' ([Lv F_v; Lw F_w] - L J u)
    return held


@inner
def actuate(arm: Arm, work: Workspace, torque: np.ndarray, grip: float) -> None:
    """Write the controls: torques ``(n, 1)`` of the arm, clipped, and of the fingers, ``grip`` in [-1, 1]."""
    for i in range(len(arm.actuators)):
        low, high = arm.limits[i]
        work.desk.ctrl[arm.actuators[i]] = min(max(torque[i, 0], low), high)
    for i in range(len(arm.finger_actuators)):
        low, high = arm.finger_limits[i]
        work.desk.ctrl[arm.finger_actuators[i]] = 0.5 * (high + low) + 0.5 * (high - low) * arm.finger_signs[i] * grip


@inner
def control_step(arm: Arm, work: Workspace, action: np.ndarray, grip: float, rest: np.ndarray) -> bool:
    """Hold one action ``(4,)``, the hand's way in units of 5 cm, for 25 physics steps; False if they diverge.

    The gripper follows ``grip`` in [-1, 1], and the arm is drawn to the posture ``rest`` ``(n,)``, rad.
    """
    desk, goal = work.desk, np.empty(3)
    for substep in range(SUBSTEPS):
        # States without a place or speed must not reach the controller, nor MuJoCo's search for contacts.
        if not (sane(work.qpos) and sane(work.qvel)):
            return False
        mj_step1(desk.model, desk.data)
        if substep == 0:  # the goal stands still for the whole control step
            for axis in range(3):
                goal[axis] = work.site_pos[arm.site, axis] + REACH * min(max(action[axis], -1.0), 1.0)
        actuate(arm, work, torques(arm, work, goal, rest), grip)
        mj_step2(desk.model, desk.data)
    return True


@inner
def observe(arm: Arm, work: Workspace, row: np.ndarray) -> None:
    """Write the observation into a row ``(O,)``: arm, hand, fingers, as robosuite's observables name them."""
    arm_size, finger_size = len(arm.qpos), len(arm.finger_qpos)
    at = 3 * arm_size
    for i in range(arm_size):
        angle = work.qpos[arm.qpos[i]]
        row[i], row[arm_size + i] = np.cos(angle), np.sin(angle)
        row[2 * arm_size + i] = work.qvel[arm.dof[i]]
    row[at : at + 3] = work.site_pos[arm.site]
    for i in range(4):  # MuJoCo puts the scalar first, robosuite last
        row[at + 3 + i] = work.body_quaternion[arm.hand, (i + 1) % 4]
    for i in range(finger_size):
        row[at + 7 + i] = work.qpos[arm.finger_qpos[i]]
        row[at + 7 + finger_size + i] = work.qvel[arm.finger_dof[i]]


@entry
def begin_episodes(arm: Arm, work: Workspace, episodes: Episodes, start: int, stop: int) -> None:
    """Compute kinematics and forces of states ``(E, S)`` from row ``start`` to ``stop``, and observe them."""
    for row in range(start, stop):
        load(work.desk, episodes.state[row])
        mj_forward(work.desk.model, work.desk.data)
        save(work.desk, episodes.state[row])
        observe(arm, work, episodes.observation[row])


@entry
def step_episodes(
    arm: Arm, work: Workspace, episodes: Episodes, rows: np.ndarray, actions: np.ndarray, valid: np.ndarray
) -> None:
    """Advance some episodes by one control step, unless that is invalid: then they stay as they were.

    Args:
        arm: The robot.
        work: The calling thread's own room.
        episodes: All episodes, updated in place.
        rows: Rows of those to advance, ``(m,)``.
        actions: ``(m, 4)`` float64, clipped here to [-1, 1].
        valid: ``(m,)``: whether the action is finite; False afterwards where the simulation diverged, too.
    """
    for i in range(len(rows)):
        row, action = rows[i], actions[i]
        grip = min(max(episodes.grip[row] + GRIPPER_SPEED * np.sign(action[3]), -1.0), 1.0)
        valid[i] = (
            valid[i]
            and load(work.desk, episodes.state[row])
            and control_step(arm, work, action, grip, episodes.rest[row])
            and save(work.desk, episodes.state[row])
        )
        if valid[i]:
            observe(arm, work, episodes.observation[row])
            episodes.grip[row] = grip
            episodes.block_z[row] = work.qpos[arm.block + 2]
