"""R2R-Lift: an arm lifts a block that it does not see from a place that the task names.

The robots are robosuite's (https://robosuite.ai), and so is the physics of every step; only the Python between the
steps is gone (see :mod:`plp_lightning.envs.lift.osc`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, NonNegativeInt, PositiveInt
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.lift.frame import Frame
from plp_lightning.envs.lift.robots import BUILDS, Robot
from plp_lightning.envs.lift.tasks import TASKS, block_place

if TYPE_CHECKING:
    from plp_lightning.envs.lift.physics import LiftPhysics
    from plp_lightning.envs.rendering.studio import Studio

VIEW = (150.0, -20.0, 1.6, (-0.1, 0.0, 1.05))  # Viewpoint of films: from beyond the table


class Lift(Simulator):
    """Lift the block with one robot, from joint angles, hand pose and fingers, blind to the block.

    The action moves the hand by up to 5 cm along x, y and z; its fourth number opens (negative) or closes
    (positive) the gripper, ramped over ten steps. The hand keeps pointing down. Control runs at 20 Hz.

    Args:
        robot: The arm: ``Sawyer``, ``UR5e``, ``Panda`` or ``Kinova3``.
        joint_noise: Standard deviation of the initial joint angles around robosuite's initial pose, rad.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Threads that step physics; 0 means one for each core.
        quarter_turns: Of the lab's frame, seen from above counterclockwise. Along its axes the hand's pose is seen, and
            the action moves it.

    Raises:
        ConfigError: If there is no such robot.
    """

    needs = ("mujoco", "numba", "robosuite")

    tasks = TASKS

    def __init__(
        self,
        robot: Robot,
        joint_noise: NonNegativeFloat = 0.05,
        horizon: PositiveInt = 200,
        threads: NonNegativeInt = 0,
        quarter_turns: NonNegativeInt = 0,
    ) -> None:
        if robot not in BUILDS:
            raise ConfigError(f"robot is {robot!r}; expected one of: {', '.join(BUILDS)}")
        self.robot, self.joint_noise, self.horizon, self.threads = robot, joint_noise, horizon, threads
        self.frame = Frame(quarter_turns)

    def spec(self, name: str) -> DomainSpec:
        """States, ``(32,)`` of a Sawyer and ``(37,)`` of a UR5e, named and ordered as robosuite's ``robot0_<key>``."""
        arm, fingers, unit, *_ = BUILDS[self.robot]
        sizes = (
            ("joint_pos_cos", arm, ""),
            ("joint_pos_sin", arm, ""),
            ("joint_vel", arm, "rad/s"),
            ("eef_pos", 3, "m"),
            ("eef_quat", 4, ""),
            ("gripper_qpos", fingers, unit),
            ("gripper_qvel", fingers, f"{unit}/s"),
        )
        keys = tuple(ObservationKey(key, (size,), unit=unit) for key, size, unit in sizes)
        env = f"robosuite Lift, {self.robot}, OSC position, fingers down, joint noise {self.joint_noise} rad"
        return DomainSpec(name, keys, action_size=4, control_hz=20.0, env=env + self.frame.told)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Position of the end effector in the world, ``(N, 3)``, m: both robots stand at the same table."""
        return self.frame.meant(state[:, self._hand[0]])

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        blocks = np.array([block_place(task) for task in tasks]).reshape(-1, 3)
        joints = BUILDS[self.robot].joints
        # Robot and task join the seed, so that equal seeds do not align the domains' initial poses.
        streams = [start_generator(s, f"{self.robot} {task}") for task, s in zip(tasks, seeds, strict=True)]
        noise = np.array([self.joint_noise * stream.standard_normal(joints) for stream in streams])
        return Observation(self._stated(self._physics.reset(blocks, noise.reshape(-1, joints))))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        physics = self._physics
        valid = physics.step(np.hstack([self.frame.meant(actions[:, :3]), actions[:, 3:]]), episodes)
        seen = Observation(self._stated(physics.episodes.observation[episodes]))
        return Step(seen, physics.lifted(episodes) & valid, ~valid)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` of robot, block and pedestal, with all that robosuite has to be seen."""
        return self._studio.pictures(self._physics, episodes, size)

    def _stated(self, state: np.ndarray) -> np.ndarray:
        """States ``(N, O)`` with the hand in the lab's frame."""
        if not self.frame.quarters:
            return state
        (hand, pose), stated = self._hand, state.copy()
        stated[:, hand], stated[:, pose] = self.frame.stated(state[:, hand]), self.frame.stated_pose(state[:, pose])
        return stated

    @cached_property
    def _hand(self) -> tuple[list[int], list[int]]:
        """Columns of the hand's position and of its pose."""
        spec = self.spec("")
        return spec.columns(["eef_pos"]), spec.columns(["eef_quat"])

    @cached_property
    def _studio(self) -> Studio:
        from plp_lightning.envs.rendering.camera import Viewpoint
        from plp_lightning.envs.rendering.studio import Studio

        return Studio(self._physics.lift.visible(), Viewpoint(*VIEW))

    @cached_property
    def _physics(self) -> LiftPhysics:
        from plp_lightning.envs.lift.physics import LiftPhysics

        return LiftPhysics(self.robot, self.threads)
