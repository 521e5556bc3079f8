"""What the golden files of other projects hold: two robots' worth of made-up numbers, the same wherever they are made.

Needs numpy alone, so that the scripts beside it can use it in environments of those projects.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

TASKS = ("push the red block", "lift the lid")
LOW, HIGH, HZ = -1.5, 2.5, 10
KEYS = {"joint_pos": (3,), "ee_pos": (2,)}
CAMERAS = {"front": (32, 40, 3), "wrist": (8, 6, 3)}


class Golden(NamedTuple):
    task: str
    seed: int
    seen: dict[str, np.ndarray]  # T + 1 rows each
    actions: np.ndarray  # (T, 2) in [LOW, HIGH]


def episodes() -> Iterator[Golden]:
    """Two demonstrations of each task, of 4 to 7 steps."""
    for number in range(4):
        random, steps = np.random.default_rng(number), 4 + number
        seen = {k: random.normal(size=(steps + 1, *shape)).astype(np.float32) for k, shape in KEYS.items()}
        for name, (height, width, channels) in CAMERAS.items():
            rows = np.add.outer(np.arange(steps + 1) * 2 + number, np.arange(height) * 2)
            flat = rows[:, :, None, None] + np.arange(width)[:, None] + np.arange(channels) * 40
            seen[name] = flat.astype(np.uint8)  # smooth, so that JPEG and video stay near it
        actions = random.uniform(LOW, HIGH, size=(steps, 2)).astype(np.float32)
        yield Golden(TASKS[number % 2], 100 + number, seen, actions)
