"""R2R-Lift on the engine: how its episodes begin, and what is kept of them."""

from __future__ import annotations

import mujoco
import numpy as np

from plp_lightning.envs.engine import Engine
from plp_lightning.envs.lift.model import PEDESTAL_HALF, LiftModel
from plp_lightning.envs.lift.osc import begin_episodes, step_episodes
from plp_lightning.envs.lift.state import Episodes, Workspace
from plp_lightning.envs.lift.tasks import BLOCK_HALF, Robot

LIFTED = 0.04
"""Rise of the block above its rest that counts as success, m."""


class LiftPhysics:
    """The episodes of one robot.

    Args:
        robot: Which.
        threads: Threads that step physics; 0 means one for each core.
    """

    episodes: Episodes

    def __init__(self, robot: Robot, threads: int) -> None:
        self.lift: LiftModel = LiftModel.build(robot)
        self.engine = Engine(self.lift.model, Workspace.of, threads)

    def reset(self, blocks: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Begin an episode for each row of ``blocks (E, 3)`` and ``noise (E, n)``; observations ``(E, O)``."""
        arm, count, engine = self.lift.arm, len(blocks), self.engine
        engine.begin(count)
        rest, size = self.lift.rest_pose + noise, 3 * len(arm.qpos) + 7 + 2 * len(arm.finger_qpos)
        qpos, mocap = engine.states[:, engine.qpos], engine.states[:, engine.columns(mujoco.mjtState.mjSTATE_MOCAP_POS)]
        qpos[:, arm.qpos], qpos[:, arm.finger_qpos] = rest, self.lift.open_fingers
        # The block starts a millimetre above its pedestal and settles in the first control step.
        qpos[:, arm.block : arm.block + 7] = [0.0, 0.0, 1e-3, 1.0, 0.0, 0.0, 0.0]
        qpos[:, arm.block : arm.block + 3] += blocks
        first = 3 * self.lift.pedestal
        mocap[:, first : first + 3] = blocks
        mocap[:, first + 2] -= BLOCK_HALF
        mocap[:, first + 2] -= PEDESTAL_HALF[2]
        observed = np.zeros((count, size), dtype=np.float32)
        self.episodes = Episodes(engine.states, np.zeros(count), rest, observed, blocks[:, 2].copy())
        self.rest_z = blocks[:, 2]
        engine.share(count, lambda work, part: begin_episodes(arm, work, self.episodes, part.start, part.stop))
        return observed.copy()

    def step(self, actions: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """One control step of ``rows (n,)``; which are valid, ``(n,)`` bool."""
        arm, episodes = self.lift.arm, self.episodes
        return self.engine.step(rows, actions, lambda work, *part: step_episodes(arm, work, episodes, *part))

    def lifted(self, rows: np.ndarray) -> np.ndarray:
        """Mask ``(n,)`` of the ``rows (n,)`` whose blocks are up."""
        up: np.ndarray = self.episodes.block_z[rows] > self.rest_z[rows] + LIFTED
        return up
