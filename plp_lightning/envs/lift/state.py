"""The data that stepping R2R-Lift reads and writes: tuples of plain arrays, which compiled code takes as they are."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from plp_lightning.envs.native import Desk


class Arm(NamedTuple):
    """Places in its model of the parts of a robot with n arm joints, g finger joints and f finger actuators."""

    site: int  # site between the fingers: the position of the end effector
    hand: int  # body whose orientation is observed
    block: int  # start of the block's free joint in qpos
    qpos: np.ndarray  # (n,), as are dof and actuators
    dof: np.ndarray
    actuators: np.ndarray
    limits: np.ndarray  # (n, 2) least and greatest torque, N m
    finger_qpos: np.ndarray  # (g,), as is finger_dof
    finger_dof: np.ndarray
    finger_actuators: np.ndarray  # (f,), as are the signs with which they follow the gripper's command
    finger_signs: np.ndarray
    finger_limits: np.ndarray  # (f, 2) least and greatest control


class Workspace(NamedTuple):
    """One thread's MjData, seen through arrays that share its memory, and room for the controller."""

    desk: Desk
    qpos: np.ndarray
    qvel: np.ndarray
    bias: np.ndarray
    inertia: np.ndarray
    site_pos: np.ndarray
    site_rotation: np.ndarray
    body_quaternion: np.ndarray
    jacobian: np.ndarray  # (6, nv): translation above rotation
    mass: np.ndarray  # (nv, nv)

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData) -> Workspace:
        """Views of ``data``, and room for J ``(6, nv)`` and M ``(nv, nv)``, valid as long as it lives."""
        return cls(
            Desk.of(model, data), data.qpos, data.qvel, data.qfrc_bias, data.qM, data.site_xpos,
            data.site_xmat, data.xquat, np.zeros((6, model.nv)), np.zeros((model.nv, model.nv)),
        )  # fmt: skip


class Episodes(NamedTuple):
    """All that is remembered of E episodes between two control steps."""

    state: np.ndarray  # (E, S): the rows of the engine
    grip: np.ndarray  # (E,) command of the gripper, ramped over ten control steps: hidden from the policy
    rest: np.ndarray  # (E, n) initial arm joints, to which motion that the hand does not feel is drawn, rad
    observation: np.ndarray  # (E, O) float32: what was last seen
    block_z: np.ndarray  # (E,) height of the block's centre, m
