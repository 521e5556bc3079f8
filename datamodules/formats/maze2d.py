"""D4RL's ``maze2d`` files: one long walk of a point from goal to goal, cut into one piece for each goal.

See https://github.com/Farama-Foundation/D4RL/blob/master/scripts/generation/generate_maze2d_datasets.py. The point is
never reset: a piece begins where the last one ended, with the velocity that is left. ``timeouts`` marks the step that
reached a goal (https://github.com/Farama-Foundation/D4RL/issues/85); files that the script writes itself lack it
(https://github.com/Farama-Foundation/D4RL/issues/176), so a new ``infos/goal`` begins a piece as well. ``rewards`` and
``terminals`` belong to the fixed goal of D4RL's evaluation and are not read.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple, NoReturn

import h5py
import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.store.guard import UNSUSPICIOUS_BYTES, open_guarded, readable

MAX_STEPS = 10_000_000  # More than twice the largest file that D4RL published; as many take 320 MB of memory


class Walk(NamedTuple):
    """The whole of a file, N steps; nothing in it is NaN or infinite."""

    states: np.ndarray  # ``(N, 4)`` float32: x, y in m, velocities in m/s, as seen before each action
    actions: np.ndarray  # ``(N, 2)`` float32: forces along x and y, the limit of the motors is 1
    goals: np.ndarray  # ``(N, 2)`` float32: where the walker is heading, in m
    timeouts: np.ndarray  # ``(N,)`` bool: the step is the last on the way to its goal
    places: np.ndarray  # ``(N, 4)`` float32: where the point was before each action, whatever was seen; else ``states``


class Segment(NamedTuple):
    """The way to one goal, T steps."""

    row: int  # Its first step in the walk
    states: np.ndarray  # ``(T + 1, 4)``, see :class:`Walk`; ``(T, 4)`` if nobody knows where the last action led
    actions: np.ndarray  # ``(T, 2)``
    goal: np.ndarray  # ``(2,)``


def read_walk(path: Path) -> Walk:
    """Read a ``maze2d`` file of N steps: states ``(N, 4)``, actions ``(N, 2)``, goals ``(N, 2)``, nothing else.

    Raises:
        TrajectoryFileError: If the file is missing, damaged or can do harm, lacks an array, has one of another shape,
            type or length, holds a value that is not finite, or more than ``MAX_STEPS`` steps.
    """
    with open_guarded(path) as file, readable(path):
        array = _array(file, "actions", path)
        steps = len(array) if array.ndim else 0
        if not 0 < steps <= MAX_STEPS:
            _refuse(path, f"{steps} steps in actions", f"1 to {MAX_STEPS}")
        floats = {"observations": 4, "actions": 2, "infos/goal": 2}
        states, actions, goals = (_floats(file, name, (steps, size), path) for name, size in floats.items())
        moved = [_floats(file, name, (steps, 2), path) for name in ("infos/qpos", "infos/qvel") if name in file]
        places = np.concatenate(moved, axis=1) if len(moved) == 2 else states
        return Walk(states, actions, goals, _flags(file, "timeouts", (steps,), path), places)


def split_walk(walk: Walk) -> list[Segment]:
    """Cut a walk ``(N, …)`` after each step that ends the way to a goal, by ``timeouts`` or as the goal changes.

    When a goal is reached the generating script records the same observation once more, with an action for the new
    goal; a piece therefore begins after a first step that repeats the one before it. Where the last action of the
    piece before led is then told by ``places`` alone: the observation after the repeated one is two actions later.
    Pieces may be empty.
    """
    another = (walk.goals[1:] != walk.goals[:-1]).any(axis=1)
    ends = np.flatnonzero(np.append(another, True) | walk.timeouts) + 1
    starts = np.append(0, ends[:-1])
    starts[1:] += (walk.states[starts[1:]] == walk.states[starts[1:] - 1]).all(axis=1)
    return [
        Segment(int(a), np.concatenate([walk.states[a:b], _led_to(walk, b)]), walk.actions[a:b], walk.goals[b - 1])
        for a, b in zip(starts, ends, strict=True)
    ]


def _led_to(walk: Walk, row: int) -> np.ndarray:
    """State that the action before ``row`` led to ``(1, 4)``; ``(0, 4)`` at the walk's end or where nothing changed."""
    place = walk.places[row : row + 1]
    led_to: np.ndarray = place[(place != walk.states[row - 1]).any(axis=1)]
    return led_to


def _floats(file: h5py.File, name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    values: np.ndarray = _array(file, name, path, shape, "f", "floating-point numbers").astype(np.float32)[()]
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        _refuse(path, f"a value that is not finite in {name}, step {bad[0]}", "finite values")
    return values


def _flags(file: h5py.File, name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    if name not in file:
        return np.zeros(shape, dtype=bool)
    values: np.ndarray = _array(file, name, path, shape, "biu", "true or false")[()].astype(bool)
    return values


def _array(
    file: h5py.File, name: str, path: Path, shape: tuple[int, ...] | None = None, kinds: str = "", told: str = ""
) -> h5py.Dataset:
    array = file.get(name)
    if not isinstance(array, h5py.Dataset):
        _refuse(path, f"no array {name}", "D4RL's maze2d arrays: observations, actions, infos/goal")
    # A growing array may have blocks larger than itself, and HDF5 unpacks whole blocks.
    block = math.prod(array.chunks or (1,)) * array.dtype.itemsize
    if block > UNSUSPICIOUS_BYTES:
        _refuse(path, f"{name} in blocks of {block / 2**20:.0f} MiB", f"at most {UNSUSPICIOUS_BYTES / 2**20:.0f} MiB")
    if shape is not None and (array.shape != shape or array.dtype.kind not in kinds):
        _refuse(path, f"{name} of shape {array.shape}, type {array.dtype}", f"shape {shape}, {told}")
    return array


def _refuse(path: Path, found: str, expected: str) -> NoReturn:
    raise TrajectoryFileError(f"{path}: found {found}; expected {expected}: name an undamaged maze2d file of D4RL")
