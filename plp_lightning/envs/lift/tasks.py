"""R2R-Lift on paper: 27 places of a block, three by three on the table at three heights."""

from __future__ import annotations

from itertools import product

import numpy as np

from plp_lightning.envs.tasks import Tasks

GRID_X = (-0.08, 0.0, 0.08)
GRID_Y = (-0.12, 0.0, 0.12)
HEIGHTS = (0.0, 0.05, 0.10)
TABLE_Z = 0.8
BLOCK_HALF = 0.02  # half the edge of the block, m. robosuite draws it anew for every model; both robots need the same
PEDESTAL_HALF = (0.018, 0.018, 0.10)
"""Half size of the pedestal below it, m: narrower than the block, so that the fingers clear it."""
PLACES = {f"x{i}y{j}h{k}": (i, j, k) for i, j, k in product(range(3), repeat=3)}
"""Name of each task and the place of its block on the grid: column, row, height."""


def block_place(task: str) -> np.ndarray:
    """Centre ``(3,)`` of the block of a task at rest, in the world, m."""
    TASKS.check([task])
    i, j, k = PLACES[task]
    return np.array([GRID_X[i], GRID_Y[j], TABLE_Z + HEIGHTS[k] + BLOCK_HALF])


def _is_apart(task: str, target: str) -> bool:
    (*position, height), (*at, high) = PLACES[task], PLACES[target]
    return height != high and position != at


TASKS = Tasks("R2R-Lift", tuple(PLACES), is_proxy=_is_apart)
"""16 of them share neither the height nor the position on the table with a target: its proxies."""
