"""What ``plp data import`` does: demonstrations of other projects → a trajectory file of ours."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.formats.d4rl import Segment, read_walk, split_walk
from datamodules.formats.source import describe_source
from datamodules.hdf5 import add_trajectories
from datamodules.types import Observation, Trajectory
from plp_lightning.envs.maze import PointMaze
from plp_lightning.versions import versions

SHORTEST = 10
"""Steps below which a way shows nothing: a tenth of a second."""
NEAR = 0.5
"""Distance from the middle of the goal cell at which our mazes count a goal as reached, in cells."""


def import_d4rl(source: Path, maze: PointMaze, domain: str, out: Path) -> None:
    """Add the demonstrations of a D4RL ``maze2d`` file to a trajectory file of ours, which may be new.

    Args:
        source: D4RL's file.
        maze: The domain's simulator, in D4RL's frame.
        domain: The domain's name in the experiment.
        out: Our file.

    Raises:
        TrajectoryFileError: If the file cannot be read, was made in another maze or has no use, or ``out`` holds
            another domain of that name or cannot be written.
    """
    segments = split_walk(read_walk(source))
    flaws = [flaw(segment, maze, source) for segment in segments]
    fit = [segment for segment, found in zip(segments, flaws, strict=True) if not found]
    dropped = Counter(found for found in flaws if found)
    if not fit:
        raise TrajectoryFileError(f"{source}: none of {len(segments)} ways can be used ({_listed(dropped)})")
    record = {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "source": {**describe_source(source), "format": "D4RL maze2d"},
        "imported": len(fit),
        "dropped": dict(dropped),
        "versions": versions(),
    }
    trajectories = [demonstration(segment, maze, domain) for segment in fit]
    add_trajectories(out, [maze.spec(domain)], maze.tasks, trajectories, record)
    tasks = len({trajectory.task for trajectory in trajectories})
    print(f"{out}: {len(fit)} demonstrations of {tasks} tasks imported; {_listed(dropped) or 'none dropped'}")


def flaw(segment: Segment, maze: PointMaze, source: Path) -> str:
    """Why a way to a goal is no demonstration, in a few words; empty if it is one.

    Raises:
        TrajectoryFileError: If it leads through a wall: it belongs to another maze.
    """
    if len(segment.actions) < SHORTEST:
        return f"shorter than {SHORTEST} steps"
    places = maze.frame.cells(segment.states[:, :2])
    cells, goal = maze.layout.nearest(places), goal_cell(segment, maze)
    _check_layout(np.vstack([cells, goal]), segment, maze, source)
    if np.linalg.norm(places[0] - goal) <= NEAR or tuple(cells[0]) == goal:
        return "begins at its goal"
    return "" if np.linalg.norm(places[-1] - goal) <= NEAR else "ends before its goal"


def demonstration(segment: Segment, maze: PointMaze, domain: str) -> Trajectory:
    """A flawless way to a goal as the domain sees it; actions beyond the limit are clipped, as D4RL's motors do.

    A walk that was never reset has no seeds; the number of the first step stands in for one.
    """
    state = maze.states_in_maze(segment.states)
    actions = maze.actions_in_maze(np.clip(segment.actions, -1, 1))
    return Trajectory(domain, task_of(segment, maze), Observation(state), actions, segment.row, success=True)


def task_of(segment: Segment, maze: PointMaze) -> str:
    """Name of the task: the zone of the cell where the way begins, and the cell of its goal."""
    start = tuple(maze.layout.nearest(maze.frame.cells(segment.states[:1, :2]))[0])
    zone = next(number for number, cells in enumerate(maze.layout.zones) if start in cells)
    row, column = goal_cell(segment, maze)
    return f"s{zone}_g_{row}_{column}"


def goal_cell(segment: Segment, maze: PointMaze) -> tuple[int, int]:
    """Row and column of the goal: D4RL draws goals around whole numbers, though cells lie 0.2 lower in its frame."""
    row, column = maze.layout.nearest(segment.goal)
    return int(row), int(column)


def _check_layout(cells: np.ndarray, segment: Segment, maze: PointMaze, source: Path) -> None:
    free: Sequence[tuple[int, int]] = maze.layout.cells
    strange = {tuple(cell) for cell in np.unique(cells, axis=0).tolist()}.difference(free)
    if strange:
        raise TrajectoryFileError(
            f"{source}: the way that begins at step {segment.row} touches cell {min(strange)}, a wall of this maze; "
            "expected a walk or a goal between its walls: choose another --layout"
        )


def _listed(dropped: Counter[str]) -> str:
    return ", ".join(f"{count} dropped: {reason}" for reason, count in sorted(dropped.items()))
