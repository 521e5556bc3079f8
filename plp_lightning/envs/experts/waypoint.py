"""The demonstrators in mazes: routes along the corridors' centre lines, the point's controller and walkers' gaits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, PositiveFloat
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.experts.gait import TRAIN, Gait, gait_path
from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze


class Guide:
    """Leads E episodes from every cell to the next; has no memory, so that clones need none.

    Whoever is beside the centre line of the corridor first heads for the line, then along it; the change is gradual.

    Args:
        maze: The maze.
        tasks: Task of each episode.
        width: Distance from the centre line beyond which only the line counts, in cells.
    """

    def __init__(self, maze: Maze, tasks: Sequence[str], width: float = 0.35) -> None:
        self._maze, self._width = maze, width
        routes = {name: self._table(name) for name in set(tasks)}
        self._next = np.stack([routes[name] for name in tasks])

    def aims(self, states: np.ndarray, episodes: np.ndarray) -> np.ndarray:
        """Points to head for, in fractional cells ``(n, 2)``, from observed states ``(n, O)``.

        With d the step from the current cell to the next, and p the position from the current cell's centre, the
        aim is p's projection on the line along d, moved forward to the next centre by the share
        ``max(0, 1 - |offset| / width)`` of the way.
        """
        position = self._maze.shared_position(states)
        cell = self._maze.layout.nearest(position)
        following = self._next[episodes, cell[:, 0], cell[:, 1]]
        ahead = (following - cell).astype(float)
        along = ((position - cell) * ahead).sum(axis=1, keepdims=True)
        foot = cell + along * ahead
        offset = np.linalg.norm(position - foot, axis=1, keepdims=True)
        share = np.maximum(0, 1 - offset / self._width)
        aims: np.ndarray = foot + share * (following - foot)
        return np.where(ahead.any(axis=1, keepdims=True), aims, cell)

    def _table(self, task: str) -> np.ndarray:
        layout = self._maze.layout
        table = np.zeros((*layout.shape, 2), dtype=int)
        for cell, following in layout.route(layout.task(task)).items():
            table[cell] = following
        return table


class WaypointExpert(Expert):
    """Accelerates a point towards the next cell of its route: action = gain (aim - position) - damping velocity.

    See D4RL's controller, https://github.com/Farama-Foundation/D4RL/blob/master/d4rl/pointmaze/waypoint_controller.py,
    which remembers its waypoint; this one does not.

    Args:
        gain: Action for each metre to the aim.
        damping: Action for each m/s.
        width: Distance from a corridor's centre line beyond which it heads for the line alone, in cells.
    """

    def __init__(
        self, gain: NonNegativeFloat = 10.0, damping: NonNegativeFloat = 1.0, width: PositiveFloat = 0.35
    ) -> None:
        self._gain, self._damping, self._width = gain, damping, width

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, PointMaze):
            found = type(simulator).__name__
            raise ConfigError(
                f"WaypointExpert demonstrates in PointMaze, not in {found}; give the domain its own expert"
            )
        self._maze, self._guide = simulator, Guide(simulator, tasks, self._width)

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        states = self._maze.states_in_maze(observation.state)
        aims = self._maze.frame.centres(self._guide.aims(observation.state, episodes))
        forces = self._gain * (aims - states[:, :2]) - self._damping * states[:, 2:]
        return self._maze.actions_of_domain(np.clip(forces, -1, 1)).astype(np.float32)


class WalkerExpert(Expert):
    """A PPO gait told at every step which way to go; neither it nor its guide remembers anything.

    Args:
        weights: The gait, a file that ``plp collect --train_expert`` wrote; the one that comes with this package
            for the body by default.
        width: Distance from a corridor's centre line beyond which it heads for the line alone, in cells.
    """

    def __init__(self, weights: Path | None = None, width: PositiveFloat = 0.35) -> None:
        self._weights, self._width = weights, width

    def check(self, simulator: Simulator) -> None:
        self._fitting(simulator)

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        self._maze, self._gait = self._fitting(simulator)
        self._guide = Guide(self._maze, tasks, self._width)

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        directions = self.directions(observation.state, episodes)
        return self._gait.act(observation.state, directions).astype(np.float32)

    def _fitting(self, simulator: Simulator) -> tuple[WalkerMaze, Gait]:
        if not isinstance(simulator, WalkerMaze):
            found = type(simulator).__name__
            raise ConfigError(
                f"WalkerExpert demonstrates in WalkerMaze, not in {found}; give the domain its own expert"
            )
        path = self._weights or gait_path(simulator.legs)
        gait = Gait.load(path)
        if gait.legs != simulator.legs:
            raise ConfigError(
                f"the gait {path} moves {gait.legs} legs, this walker has {simulator.legs}; "
                f"name another file or train one with: {TRAIN}"
            )
        return simulator, gait

    def directions(self, states: np.ndarray, episodes: np.ndarray) -> np.ndarray:
        """Unit vectors ``(n, 2)`` in the maze's frame, along which to walk from states ``(n, O)``."""
        aims = self._maze.frame.centres(self._guide.aims(states, episodes))
        ways = aims - states[:, :2]
        directions: np.ndarray = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
        return directions
