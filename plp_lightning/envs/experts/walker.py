"""The demonstrator of ant and spider: a learned gait, steered along the route to the goal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.experts.gait import TRAIN, Gait, gait_path
from plp_lightning.envs.experts.waypoint import Guide
from plp_lightning.envs.maze.simulator import WalkerMaze


class WalkerExpert(Expert):
    """A PPO gait told at every step which way to go; neither it nor its guide remembers anything.

    Args:
        weights: The gait, a file that ``plp collect --train_expert`` wrote; the one that comes with this package
            for the body by default.
        width: See :class:`plp_lightning.envs.experts.waypoint.Guide`.
    """

    def __init__(self, weights: Path | None = None, width: float = 0.35) -> None:
        self._weights = weights
        self._width = width

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, WalkerMaze):
            found = type(simulator).__name__
            raise ConfigError(
                f"WalkerExpert demonstrates in WalkerMaze, not in {found}; give the domain its own expert"
            )
        path = self._weights or gait_path(simulator.legs)
        self._maze, self._gait = simulator, Gait.load(path)
        if self._gait.legs != simulator.legs:
            raise ConfigError(
                f"the gait {path} moves {self._gait.legs} legs, this walker has {simulator.legs}; "
                f"name another file or train one with: {TRAIN}"
            )
        self._guide = Guide(self._maze, tasks, self._width)

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        directions = self.directions(observation.state, episodes)
        return self._gait.act(observation.state, directions).astype(np.float32)

    def directions(self, states: np.ndarray, episodes: np.ndarray) -> np.ndarray:
        """Unit vectors ``(n, 2)`` in the maze's frame: where to walk from states ``(n, O)``."""
        aims = self._maze.frame.centres(self._guide.aims(states, episodes))
        ways = aims - states[:, :2]
        directions: np.ndarray = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
        return directions
