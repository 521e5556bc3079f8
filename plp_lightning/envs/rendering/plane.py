"""Pictures of a plane with discs on it, drawn by numpy alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Colour = tuple[int, int, int]


class Discs(NamedTuple):
    """A disc in each of n episodes, all of one kind."""

    places: np.ndarray  # centres (n, 2), x to the right and y up
    radius: float
    colour: Colour


def draw_discs(layers: Sequence[Discs], reach: float, size: tuple[int, int]) -> np.ndarray:
    """Pictures ``(n, H, W, 3)`` uint8 of layers of discs, later ones on top, from ``-reach`` to ``reach`` on white."""
    height, width = size
    pixel = 2 * reach / min(size)
    x, y = (np.arange(width) + 0.5 - width / 2) * pixel, (height / 2 - 0.5 - np.arange(height)) * pixel
    pictures = np.full((len(layers[0].places), height, width, 3), 255, dtype=np.uint8)
    for places, radius, colour in layers:
        across, up = x - places[:, :1], y - places[:, 1:]
        inside = up[:, :, None] ** 2 + across[:, None] ** 2 <= radius**2
        pictures[inside] = colour
    return pictures
