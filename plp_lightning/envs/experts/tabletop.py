"""The demonstrators of V2V: Meta-World's scripted policies, clipped to [-1, 1].

See https://github.com/Farama-Foundation/Metaworld/tree/master/metaworld/policies. They are told where the ball or the
handle is, which a policy has to see; for the rest they know the observation alone and remember nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.tabletop.simulator import Reach, Window

REACH_GAIN = 5.0  # action for each metre to the ball
FINGERS = np.array([0.0, 0.0, -0.045])  # from the hand to the fingertips, m

WINDOW_GAIN = 25.0
BESIDE = np.array([0.03, -0.03, -0.08])  # from the handle to where the hand pushes it, m; x is mirrored to open
ABOVE = {"open": 0.3, "close": 0.25}  # height over that place at which the hand gathers, m
OVER = 0.04  # distance along the table at which the hand descends, m
LOW = 0.02  # distance in height at which the hand pushes, m
PUSH = 0.1  # way ahead of itself that the hand aims at then, m


class ReachExpert(Expert):
    """Moves the fingertips to the ball, slower as they get there."""

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, Reach):
            raise ConfigError(f"ReachExpert got simulator {type(simulator).__name__}; expected Reach, pair them so")
        self._simulator = simulator

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return reach(observation.state[:, :3], self._simulator.aims(episodes))


class WindowExpert(Expert):
    """Gathers above the handle, descends beside it, pushes."""

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, Window):
            raise ConfigError(f"WindowExpert got simulator {type(simulator).__name__}; expected Window, pair them so")
        self._simulator = simulator
        self._opens = np.array([task == "open" for task in tasks], dtype=np.bool_)

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return push(observation.state[:, :3], self._simulator.aims(episodes), self._opens[episodes])


def reach(hand: np.ndarray, ball: np.ndarray) -> np.ndarray:
    """Actions ``(n, 4)`` that bring the fingertips of a hand ``(n, 3)`` to a ball ``(n, 3)``."""
    # Meta-World's policy brings the hand there, whose fingertips end 4.5 cm below.
    return _action(REACH_GAIN * (ball - FINGERS - hand), grip=0.0)


def push(hand: np.ndarray, handle: np.ndarray, opens: np.ndarray) -> np.ndarray:
    """Actions ``(n, 4)`` of a hand ``(n, 3)`` that pushes a handle ``(n, 3)`` along x: forward if it ``opens``."""
    forward = np.where(opens, 1.0, -1.0)
    place = handle + BESIDE * np.column_stack([-forward, np.ones((len(hand), 2))])
    far = np.linalg.norm(place[:, :2] - hand[:, :2], axis=1) > OVER
    high = ~far & (np.abs(place[:, 2] - hand[:, 2]) > LOW)
    place[:, 2] += far * np.where(opens, ABOVE["open"], ABOVE["close"])
    place[:, 0] += ~(far | high) * forward * PUSH
    return _action(WINDOW_GAIN * (place - hand), grip=1.0)


def _action(way: np.ndarray, grip: float) -> np.ndarray:
    return np.column_stack([np.clip(way, -1.0, 1.0), np.full(len(way), grip)]).astype(np.float32)
