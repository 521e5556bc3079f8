"""The demonstrator of R2R-Lift: reach, descend, grasp, lift, from the hand's position and the fingers alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.lift.robots import BUILDS
from plp_lightning.envs.lift.simulator import Lift
from plp_lightning.envs.lift.tasks import block_place

GAIN = 3.0  # largest share of the way to the goal that a control step covers: 1 is slow, 10 chatters
STEP = 0.05  # way of the hand for an action of 1, m
ABOVE = 0.07  # height over the block at which the hand gathers before it descends, m
CLEAR = 0.045  # height over the block below which the hand rises before it moves sideways, m
CREEP = 0.15  # share of the sideways motion that is left while the hand rises
LIFT = 0.15  # height to which the block is lifted, m; more than success asks for
NEAR = 0.01  # distance along the table and in height at which the fingers close, m
OVER = 0.02  # distance along the table at which the hand descends, m


class LiftExpert(Expert):
    """A proportional controller of the hand in four stages, with no memory that a policy would have to guess.

    The stage follows from the observation alone, so behavioural cloning without memory can copy it:
    holding the block, lift it; at the block, close; over it, descend; else gather above it.
    """

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, Lift):
            raise ConfigError(f"LiftExpert got simulator {type(simulator).__name__}; expected Lift, pair them so")
        spec = simulator.spec(simulator.robot)
        self._hand = spec.columns(["eef_pos"])
        self._finger = spec.columns(["gripper_qpos"])[0]
        self._sign, self._threshold = BUILDS[simulator.robot].holds
        blocks = np.array([block_place(task) for task in tasks]).reshape(-1, 3)
        self._blocks = simulator.frame.stated(blocks)  # as the hand's position is seen, and as it is told to move

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        hand = observation.state[:, self._hand].astype(np.float64)
        block = self._blocks[episodes]
        aside = np.linalg.norm(block[:, :2] - hand[:, :2], axis=1)
        closed = self._sign * (observation.state[:, self._finger] - self._threshold) > 0.0
        holds = closed & (aside < OVER)  # a hand that is closed elsewhere is empty: it opens on its way
        there = (aside < NEAR) & (np.abs(block[:, 2] - hand[:, 2]) < NEAR)
        above = np.select([holds, aside < OVER], [LIFT, 0.0], ABOVE)
        way = block + above[:, None] * [0.0, 0.0, 1.0] - hand
        low = (aside >= OVER) & (hand[:, 2] < block[:, 2] + CLEAR)
        way[low, :2] *= CREEP
        grip = np.where(holds | there, 1.0, -1.0)
        return np.column_stack([np.clip(GAIN * way / STEP, -1.0, 1.0), grip]).astype(np.float32)
