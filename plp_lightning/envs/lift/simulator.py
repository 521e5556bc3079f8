"""R2R-Lift: a Sawyer or a UR5e lifts a block that it does not see from a place that the task names.

The block's place is one of 27: a grid of three by three positions on the table and three heights, held by
a pedestal. The robots are robosuite's (https://robosuite.ai), and so is the physics of every step; only
the Python between the steps is gone (see :mod:`plp_lightning.envs.lift.osc`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from difflib import get_close_matches
from itertools import product
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from datamodules.errors import ConfigError
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.threads import available_cores

if TYPE_CHECKING:
    import mujoco

    from plp_lightning.envs.lift.model import LiftModel
    from plp_lightning.envs.lift.state import Arm, Episodes, Workspace

Robot = Literal["Sawyer", "UR5e"]

GRID_X = (-0.08, 0.0, 0.08)
GRID_Y = (-0.12, 0.0, 0.12)
HEIGHTS = (0.0, 0.05, 0.10)
TASKS = {f"x{i}y{j}h{k}": (i, j, k) for i, j, k in product(range(3), repeat=3)}
"""Name of each task and the place of its block on the grid."""

TABLE_Z = 0.8
BLOCK_HALF = 0.02
PEDESTAL_HALF_HEIGHT = 0.10
LIFTED = 0.04
"""Rise of the block above its rest that counts as success, m."""
JOINTS: dict[str, tuple[int, int]] = {"Sawyer": (7, 2), "UR5e": (6, 6)}
"""Joints of the arm and of the fingers."""


class Lift(Simulator):
    """Lift the block with one robot, from joint angles, hand pose and fingers, blind to the block.

    The action moves the hand by up to 5 cm along x, y and z; its fourth number opens (negative) or closes
    (positive) the gripper, ramped over ten steps. The hand keeps pointing down. Control runs at 20 Hz.

    Args:
        robot: The arm, ``Sawyer`` or ``UR5e``.
        joint_noise: Standard deviation of the initial joint angles around robosuite's initial pose, rad.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Threads that step physics; 0 means one for each core.

    Raises:
        ConfigError: If an argument is out of its range.
    """

    def __init__(self, robot: Robot, joint_noise: float = 0.05, horizon: int = 200, threads: int = 0) -> None:
        if robot not in get_args(Robot):
            raise ConfigError(f"robot is {robot!r}; expected one of: {', '.join(get_args(Robot))}")
        if not 0.0 <= joint_noise < np.inf:
            raise ConfigError(f"joint_noise is {joint_noise}; expected a standard deviation in rad, 0 or more")
        if horizon < 1 or threads < 0:
            raise ConfigError(f"horizon is {horizon}, threads is {threads}; expected at least 1 and at least 0")
        self.robot, self.joint_noise, self.horizon, self.threads = robot, joint_noise, horizon, threads
        self._physics: _Physics | None = None

    @property
    def tasks(self) -> tuple[str, ...]:
        """``x0y0h0`` to ``x2y2h2``: column, row and height of the block's place."""
        return tuple(TASKS)

    def proxy_tasks(self, target: str) -> tuple[str, ...]:
        """The 16 tasks that share neither the height nor the position on the table with ``target``.

        Raises:
            ConfigError: If there is no such task.
        """
        *position, height = _place(target)
        return tuple(name for name, (i, j, k) in TASKS.items() if k != height and [i, j] != position)

    def spec(self, name: str) -> DomainSpec:
        """32 numbers of state for Sawyer, 37 for UR5e, named and ordered as robosuite's ``robot0_<key>``."""
        arm, fingers = JOINTS[self.robot]
        finger_unit = "m" if self.robot == "Sawyer" else "rad"
        sizes = (
            ("joint_pos_cos", arm, ""),
            ("joint_pos_sin", arm, ""),
            ("joint_vel", arm, "rad/s"),
            ("eef_pos", 3, "m"),
            ("eef_quat", 4, ""),
            ("gripper_qpos", fingers, finger_unit),
            ("gripper_qvel", fingers, f"{finger_unit}/s"),
        )
        keys = tuple(ObservationKey(key, (size,), unit=unit) for key, size, unit in sizes)
        env = f"robosuite Lift, {self.robot}, OSC position, fingers down, joint noise {self.joint_noise} rad"
        return DomainSpec(name, keys, action_size=4, control_hz=20.0, env=env)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Position of the end effector in the world, ``(N, 3)``, m: both robots stand at the same table."""
        position: np.ndarray = state[:, self.spec("").columns(["eef_pos"])]
        return position

    def block(self, task: str) -> np.ndarray:
        """Where the block of a task rests: its centre ``(3,)`` in the world, m.

        Raises:
            ConfigError: If there is no such task.
        """
        i, j, k = _place(task)
        return np.array([GRID_X[i], GRID_Y[j], TABLE_Z + HEIGHTS[k] + BLOCK_HALF])

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin E episodes; the first call builds the model.

        Raises:
            ConfigError: If a task is unknown.
        """
        blocks = np.array([self.block(task) for task in tasks]).reshape(-1, 3)
        joints = JOINTS[self.robot][0]
        noise = np.array([self._noise(task, seed, joints) for task, seed in zip(tasks, seeds, strict=True)])
        if self._physics is None:
            self._physics = _Physics(self.robot, self.threads or available_cores())
        return Observation(self._physics.reset(blocks, noise.reshape(-1, joints)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Apply ``actions (n, 4)`` to ``episodes (n,)``; an invalid step leaves its episode as it was."""
        assert self._physics is not None, "reset comes before step"
        return self._physics.step(np.asarray(actions, dtype=np.float64), np.asarray(episodes, dtype=np.int64))

    def _noise(self, task: str, seed: int, joints: int) -> np.ndarray:
        # Robot and task join the seed, so that equal seeds do not align the domains' initial poses.
        stream = start_generator(seed, f"{self.robot} {task}")
        return self.joint_noise * stream.standard_normal(joints)


def _place(task: str) -> tuple[int, int, int]:
    if task not in TASKS:
        near = get_close_matches(task, TASKS, n=1, cutoff=0.0)[0]
        raise ConfigError(f"no task {task!r} in R2R-Lift; expected x0y0h0 to x2y2h2, did you mean {near!r}?")
    return TASKS[task]


class _Physics:
    """The compiled model, a workspace for each thread, and the state of all episodes."""

    def __init__(self, robot: Robot, threads: int) -> None:
        import mujoco

        from plp_lightning.envs.lift.model import LiftModel
        from plp_lightning.envs.lift.state import Workspace

        self.lift: LiftModel = LiftModel.build(robot)
        self.arm: Arm = self.lift.arm
        self.data: list[mujoco.MjData] = [mujoco.MjData(self.lift.model) for _ in range(threads)]
        self.workspaces: list[Workspace] = [Workspace.of(self.lift.model, data) for data in self.data]
        self.pool = ThreadPoolExecutor(threads, thread_name_prefix="lift")
        self.episodes: Episodes
        self.rest_z: np.ndarray

    def reset(self, blocks: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Begin an episode for each row of ``blocks (E, 3)`` and ``noise (E, n)``; observations ``(E, O)``."""
        import mujoco

        from plp_lightning.envs.lift.osc import STATE, observe
        from plp_lightning.envs.lift.state import Episodes

        count, lift, data, work = len(blocks), self.lift, self.data[0], self.workspaces[0]
        size = 3 * len(lift.arm.qpos) + 7 + 2 * len(lift.arm.finger_qpos)
        self.episodes = Episodes(
            state=np.zeros((count, mujoco.mj_stateSize(lift.model, STATE))),
            grip=np.zeros(count),
            rest=lift.rest_pose + noise,
            observation=np.zeros((count, size), dtype=np.float32),
            block_z=blocks[:, 2].copy(),
        )
        self.rest_z = blocks[:, 2]
        for row, block in enumerate(blocks):
            self._place_episode(block, self.episodes.rest[row])
            mujoco.mj_getState(lift.model, data, self.episodes.state[row], STATE)
            observe(self.arm, work, self.episodes.observation[row])
        return self.episodes.observation.copy()

    def _place_episode(self, block: np.ndarray, pose: np.ndarray) -> None:
        import mujoco

        lift, data = self.lift, self.data[0]
        mujoco.mj_resetData(lift.model, data)
        data.qpos[lift.arm.qpos] = pose
        data.qpos[lift.arm.finger_qpos] = lift.open_fingers
        # The block starts a millimetre above its pedestal and settles in the first control step.
        data.qpos[lift.arm.block : lift.arm.block + 7] = [*block[:2], block[2] + 1e-3, 1.0, 0.0, 0.0, 0.0]
        data.mocap_pos[lift.pedestal] = [*block[:2], block[2] - BLOCK_HALF - PEDESTAL_HALF_HEIGHT]
        mujoco.mj_forward(lift.model, data)

    def step(self, actions: np.ndarray, rows: np.ndarray) -> Step:
        """One control step of ``rows (n,)``, shared out among the threads."""
        invalid = np.zeros(len(rows), dtype=np.bool_)
        # The threads take one episode after the other, so that none waits long for the last.
        queue = deque(range(len(rows)))
        workers = min(len(self.workspaces), len(rows))
        if workers == 1:
            self._work(0, queue, rows, actions, invalid)
        else:
            jobs = [self.pool.submit(self._work, k, queue, rows, actions, invalid) for k in range(workers)]
            for job in jobs:
                job.result()
        success = (self.episodes.block_z > self.rest_z + LIFTED)[rows] & ~invalid
        return Step(Observation(self.episodes.observation[rows]), success, invalid)

    def _work(self, worker: int, queue: deque[int], rows: np.ndarray, actions: np.ndarray, invalid: np.ndarray) -> None:
        from plp_lightning.envs.lift.osc import step_episode

        work = self.workspaces[worker]
        while queue:
            try:
                i = queue.popleft()
            except IndexError:  # another thread took the last one
                return
            invalid[i] = not step_episode(self.arm, work, self.episodes, rows[i], actions[i])
