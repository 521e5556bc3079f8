"""Shares of episodes that take no time and count: what goes through a pool of processes shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.base import Step


@dataclass(frozen=True)
class Counting:
    """Makes shares whose states count steps, and in which actions are orders."""

    camera: bool = False

    def share(self) -> Counter:
        return Counter(self.camera)


class Counter:
    """States ``(n, 2)``: the seed, and the sum of actions; 7 as an action fails, 8 shows more than was promised."""

    def __init__(self, camera: bool) -> None:
        self.camera = camera

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.state = np.stack([seeds, np.zeros(len(seeds))], axis=1).astype(np.float32)
        return self._shown(np.arange(len(seeds)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        if (actions == 7).any():
            raise ZeroDivisionError("seven")
        self.state[episodes, 1] += actions[:, 0]
        shown, solved = self._shown(episodes), self.state[episodes, 1] > 2
        if (actions == 8).any():
            shown = shown._replace(state=shown.state[:, :1])
        return Step(shown, solved, np.zeros(len(episodes), bool), actions[:, 0] == 6)

    def seeds(self, episodes: np.ndarray, factor: int) -> list[np.ndarray]:
        return [factor * self.state[i, :1] for i in episodes]

    def _shown(self, episodes: np.ndarray) -> Observation[np.ndarray]:
        if not self.camera:
            return Observation(self.state[episodes])
        eye = np.broadcast_to(self.state[episodes, 1, None, None, None], (len(episodes), 2, 3, 1)).astype(np.uint8)
        return Observation(self.state[episodes, :0], {"left eye": eye, "state": eye + 1})
