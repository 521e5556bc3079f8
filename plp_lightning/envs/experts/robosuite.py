"""The demonstrator of robosuite's Lift and Stack: reach, descend, grasp, lift, and put one block on the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.suites.robosuite import Robosuite

BLOCKS = {"Lift": ("cube_pos",), "Stack": ("cubeA_pos", "cubeB_pos")}
"""Keys of the block that is lifted and of the one that it is put on, by task."""
FINGERS = {"Panda": (-1.0, 0.027), "Sawyer": (-1.0, 0.006), "UR5e": (1.0, 0.33)}
"""Sign and threshold of the first finger joint: beyond it the fingers are as closed as on a block."""
GAIN = 3.0  # largest share of the way to the goal that a control step covers
STEP = 0.05  # way of the hand for an action of 1, m
ABOVE = 0.07  # height over the block at which the hand gathers before it descends, m
CLEAR = 0.045  # height below which the hand rises before it moves sideways, m
CREEP = 0.15  # share of the sideways motion that is left while the hand rises
RAISED = 0.15  # height to which a block is lifted, m
NEAR, OVER = 0.01, 0.02  # distances at which the fingers close, and at which the hand descends, m
PILED = 0.045  # height of one block's centre over the other's when it is let go, m


class RobosuiteExpert(Expert):
    """Lifts a block in Lift, and puts it on the other one in Stack, with one arm and ``OSC_POSITION``.

    It is told where the blocks are, and remembers nothing, so that behavioural cloning can copy it.
    """

    def check(self, simulator: Simulator) -> None:
        if not isinstance(simulator, Robosuite):
            raise ConfigError(f"RobosuiteExpert got simulator {type(simulator).__name__}; expected Robosuite")
        robot, names = "+".join(simulator.setup.robots), {variant.name for variant in simulator.variants}
        if robot not in FINGERS or simulator.setup.controller != "OSC_POSITION" or not names <= BLOCKS.keys():
            told = f"RobosuiteExpert is asked for {', '.join(sorted(names))} with {robot}, {simulator.setup.controller}"
            known = f"{' or '.join(BLOCKS)} with {', '.join(FINGERS)}, OSC_POSITION"
            raise ConfigError(f"{told}; expected {known}: demonstrate it in files, or write an expert")

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        self.check(simulator)
        assert isinstance(simulator, Robosuite)
        self._simulator = simulator
        names = {variant.name for variant in simulator.variants}
        if len(names) > 1:
            raise ConfigError(f"RobosuiteExpert is asked for {', '.join(sorted(names))} at once; expected one of them")
        self._keys = ("robot0_eef_pos", *BLOCKS[names.pop()])
        self._sign, self._threshold = FINGERS[simulator.setup.robots[0]]

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        told = self._simulator.told(episodes, (*self._keys, "robot0_gripper_qpos"))
        hand, block, *below = np.split(told[:, : 3 * len(self._keys)], len(self._keys), axis=1)
        closed = self._sign * (told[:, 3 * len(self._keys)] - self._threshold) > 0.0
        aside = np.linalg.norm(block[:, :2] - hand[:, :2], axis=1)
        beside = np.abs(block[:, 2] - hand[:, 2])
        holds = closed & (aside < OVER) & (beside < OVER)
        there = (aside < NEAR) & (beside < NEAR)
        way = block + np.where(aside < OVER, 0.0, ABOVE)[:, None] * [0.0, 0.0, 1.0] - hand
        low = (aside >= OVER) & (hand[:, 2] < block[:, 2] + CLEAR)
        grip = np.where(holds | there, 1.0, -1.0)
        way[holds] = [0.0, 0.0, RAISED]
        if below:
            low &= ~holds
            _pile(holds, closed, below[0] - block, way, grip)
        way[low, :2] *= CREEP
        return np.column_stack([np.clip(GAIN * way / STEP, -1.0, 1.0), grip]).astype(np.float32)


def _pile(holds: np.ndarray, closed: np.ndarray, apart: np.ndarray, way: np.ndarray, grip: np.ndarray) -> None:
    """Change ways ``(n, 3)`` and grips ``(n,)`` of those who hold a block ``apart`` ``(n, 3)`` from the one below."""
    aside, height = np.linalg.norm(apart[:, :2], axis=1), -apart[:, 2]
    over = aside < NEAR
    raised = holds & ((height > PILED + OVER) | over)
    carried = np.column_stack([apart[:, :2], np.where(over, 0.0, ABOVE) + PILED - height])
    way[raised] = carried[raised]
    piled = over & (height > PILED / 2) & (height < PILED + NEAR / 2)
    grip[piled] = -1.0
    way[piled] = np.where(closed, 0.0, ABOVE)[piled, None] * [0.0, 0.0, 1.0]  # up, once the fingers are open
