"""``plp data import``: demonstrations of other projects → a trajectory file of ours."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.formats import describe_source
from datamodules.formats.maze2d import Segment, Walk, read_walk, split_walk
from datamodules.store.writer import add_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.runs.versions import versions

SHORTEST = 10  # Steps below which a way shows nothing: a tenth of a second
NEAR = 0.5  # Distance from the middle of the goal cell at which our mazes count a goal as reached, in cells


def import_d4rl(source: Path, maze: PointMaze, domain: str, out: Path) -> None:
    """Add the demonstrations of a D4RL ``maze2d`` file to a trajectory file of ours, which may be new.

    Raises:
        TrajectoryFileError: If the file cannot be read, was made in another maze or has no use, or ``out`` holds
            another domain of that name or cannot be written.
    """
    walk = read_walk(source)
    pieces = split_walk(walk)
    ways = [piece for piece in pieces if len(piece.actions) >= SHORTEST]
    flaws = _flaws(ways, walk, maze, source)
    fit = [way for way, flaw in zip(ways, flaws, strict=True) if not flaw]
    short = [f"shorter than {SHORTEST} steps"] * (len(pieces) - len(ways))
    dropped = Counter([*filter(None, flaws), *short])
    if not fit:
        raise TrajectoryFileError(f"{source}: none of {len(pieces)} ways can be used ({_listed(dropped)})")
    record = {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "source": {**describe_source(source), "format": "D4RL maze2d"},
        "imported": len(fit),
        "dropped": dict(dropped),
        "versions": versions(),
    }
    tasks = _tasks(fit, maze)
    trajectories = [demonstration(way, task, maze, domain) for way, task in zip(fit, tasks, strict=True)]
    add_trajectories(out, [maze.spec(domain)], maze.tasks.names, trajectories, record)
    print(f"{out}: {len(fit)} demonstrations of {len({*tasks})} tasks imported; {_listed(dropped) or 'none dropped'}")


def _flaws(ways: Sequence[Segment], walk: Walk, maze: PointMaze, source: Path) -> list[str]:
    """In a few words, why each way to a goal is no demonstration; empty if it is one."""
    # D4RL draws goals around whole numbers, which name the cell, though cells lie 0.2 lower in its frame.
    places = maze.frame.cells(walk.states[:, :2])
    cells, goals = maze.layout.nearest(places), maze.layout.nearest(walk.goals)
    _check_layout(np.stack([cells, goals], axis=1), maze, source)
    first = np.array([way.row for way in ways], dtype=int)
    last = first + np.array([len(way.actions) - 1 for way in ways], dtype=int)
    near = np.linalg.norm(places - goals, axis=1) <= NEAR
    begins = near[first] | (cells[first] == goals[first]).all(axis=1)
    flaws: list[str] = np.select([begins, ~near[last]], ["begins at its goal", "ends before its goal"], "").tolist()
    return flaws


def _tasks(ways: Sequence[Segment], maze: PointMaze) -> list[str]:
    """Names of the tasks: the zone of the cell where a way begins, and the cell of its goal."""
    zone_of = {cell: zone for zone, cells in enumerate(maze.layout.zones) for cell in cells}
    starts = maze.layout.nearest(maze.frame.cells(np.array([way.states[0, :2] for way in ways])))
    goals = maze.layout.nearest(np.array([way.goal for way in ways]))
    pairs = zip(starts.tolist(), goals.tolist(), strict=True)
    return [f"s{zone_of[start[0], start[1]]}_g_{goal[0]}_{goal[1]}" for start, goal in pairs]


def demonstration(way: Segment, task: str, maze: PointMaze, domain: str) -> Trajectory:
    """A flawless way to a goal, ``(T, 2)`` actions, as the domain sees it; D4RL's motors clip too strong actions too.

    A walk that was never reset has no seeds; the number of the first step stands in for one.
    """
    state, actions = maze.states_of_domain(way.states), maze.actions_of_domain(np.clip(way.actions, -1, 1))
    return Trajectory(domain, task, Observation(state), actions, way.row, success=True)


def _check_layout(cells: np.ndarray, maze: PointMaze, source: Path) -> None:
    """Cells ``(N, 2, 2)``: where the walker and its goal are in each step."""
    free = np.zeros(maze.layout.shape, dtype=bool)
    free[tuple(np.transpose(maze.layout.cells))] = True
    strange = np.argwhere(~free[cells[..., 0], cells[..., 1]])
    if len(strange):
        step, goal = strange[0].tolist()
        found = f"{'the goal' if goal else 'the walk'} of step {step} in cell {tuple(cells[step, goal].tolist())}"
        raise TrajectoryFileError(
            f"{source}: found {found}, a wall of this maze; expected places between its walls: choose another --layout"
        )


def _listed(dropped: Counter[str]) -> str:
    return ", ".join(f"{count} dropped: {reason}" for reason, count in sorted(dropped.items()))
