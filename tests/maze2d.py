"""Files like D4RL's ``maze2d-umaze-sparse-v1``, with its fields and its quirks, for a point that moves at will."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np

CORRIDOR = ((1, 1), (1, 2), (1, 3), (2, 3), (3, 3), (3, 2), (3, 1))
"""The free cells of umaze, in the order in which one walks through them."""
PACE = 0.08
"""Way of the point in a step, m."""
SHIFT = -0.2
"""A cell's middle lies so far from its whole numbers in D4RL's frame, m."""

Arrays = dict[str, np.ndarray]


def way(start: int, goal: int) -> np.ndarray:
    """Positions ``(T, 2)`` from one cell of the corridor to another, both by their place in it."""
    turn = 1 if goal >= start else -1
    cells = np.array([CORRIDOR[i] for i in range(start, goal + turn, turn)], dtype=float) + SHIFT
    marks = np.arange(0, len(cells) - 1 + 1e-9, PACE)
    return np.stack([np.interp(marks, np.arange(len(cells)), cells[:, axis]) for axis in (0, 1)], axis=1)


def walk(places: Sequence[int], seed: int = 0) -> Arrays:
    """A walk from the first of ``places`` in the corridor to all others in turn, as D4RL's script records it.

    When a goal is reached, the next row holds the old observation, while ``infos/qpos`` holds the new position.
    """
    rng = np.random.default_rng(seed)
    pieces: list[Arrays] = []
    for start, goal in pairwise(places):
        position = way(start, goal)
        velocity = np.gradient(position, axis=0) / 0.01
        seen = np.concatenate([position, velocity], axis=1)
        if pieces:
            seen[0] = pieces[-1]["observations"][-1]
        steps = len(seen)
        target = np.array(CORRIDOR[goal]) + rng.uniform(-0.1, 0.1, 2)
        pieces.append(
            {
                "observations": seen.astype(np.float32),
                "actions": np.clip(velocity / 5, -1, 1).astype(np.float32),
                "rewards": np.zeros(steps, np.float32),
                "terminals": np.zeros(steps, bool),
                "timeouts": np.arange(steps) == steps - 1,
                "infos/goal": np.tile(target.astype(np.float32), (steps, 1)),
                "infos/qpos": position,
                "infos/qvel": velocity,
            }
        )
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def all_pairs() -> list[int]:
    """Places such that every cell of the corridor is left for every other one."""
    places, left = [0], {(a, b) for a in range(7) for b in range(7) if a != b}
    while left:
        near = [b for a, b in sorted(left) if a == places[-1]]
        places.append(near[0] if near else min(left)[0])
        left.discard((places[-2], places[-1]))
    return places


def write(path: Path, arrays: Arrays) -> Path:
    """Write the arrays as D4RL does: plain, gzip-compressed, nothing else in the file."""
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, compression="gzip")
    return path
