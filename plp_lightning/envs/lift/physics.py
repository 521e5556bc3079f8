"""R2R-Lift on the engine: how its episodes begin, and what is kept of them."""

from __future__ import annotations

import mujoco
import numpy as np

from plp_lightning.envs.engine import Engine
from plp_lightning.envs.lift.model import LiftModel
from plp_lightning.envs.lift.osc import begin_episodes, step_episodes
from plp_lightning.envs.lift.robots import Robot
from plp_lightning.envs.lift.state import Episodes, Workspace
from plp_lightning.envs.lift.tasks import BLOCK_HALF, PEDESTAL_HALF

LIFTED = 0.04  # rise of the block above its rest that counts as success, m


class LiftPhysics(Engine[Workspace]):
    """The episodes of one robot, stepped by so many ``threads``; 0 means one for each core."""

    episodes: Episodes

    def __init__(self, robot: Robot, threads: int) -> None:
        self.lift = LiftModel.build(robot)
        super().__init__(self.lift.model, threads)

    def room(self, data: mujoco.MjData) -> Workspace:
        return Workspace.of(self.model, data)

    def reset(self, blocks: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Begin an episode for each row of blocks ``(E, 3)`` and noise ``(E, n)``; observations ``(E, O)``."""
        arm, count = self.lift.arm, len(blocks)
        self.begin(count)
        rest, size = self.lift.rest_pose + noise, 3 * len(arm.qpos) + 7 + 2 * len(arm.finger_qpos)
        qpos, mocap = self.states[:, self.qpos], self.states[:, self.columns(mujoco.mjtState.mjSTATE_MOCAP_POS)]
        qpos[:, arm.qpos], qpos[:, arm.finger_qpos] = rest, self.lift.open_fingers
        # The block starts a millimetre above its pedestal and settles in the first control step.
        qpos[:, arm.block : arm.block + 7] = [0.0, 0.0, 1e-3, 1.0, 0.0, 0.0, 0.0]
        qpos[:, arm.block : arm.block + 3] += blocks
        first = 3 * self.lift.pedestal
        mocap[:, first : first + 3] = blocks
        mocap[:, first + 2] -= BLOCK_HALF
        mocap[:, first + 2] -= PEDESTAL_HALF[2]  # apart: the sum of both would round otherwise
        observed, self.rest_z = np.zeros((count, size), dtype=np.float32), blocks[:, 2]
        self.episodes = Episodes(self.states, np.zeros(count), rest, observed, self.rest_z.copy())
        self.share(count, lambda work, part: begin_episodes(arm, work, self.episodes, part.start, part.stop))
        return observed.copy()

    def step(self, actions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Advance rows ``(n,)`` by one control step; a mask ``(n,)`` of those that are valid."""
        arm, episodes = self.lift.arm, self.episodes
        return self.advance(rows, actions, lambda work, *part: step_episodes(arm, work, episodes, *part))

    def lifted(self, rows: np.ndarray) -> np.ndarray:
        """Mask ``(n,)`` of the rows ``(n,)`` whose blocks are up."""
        up: np.ndarray = self.episodes.block_z[rows] > self.rest_z[rows] + LIFTED
        return up
