"""Pictures of a plane with discs and bars on it, drawn by numpy alone."""

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

    def cover(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """True for the points ``(n, H, W)`` of a grid with columns ``x (W,)`` and rows ``y (H,)`` that they are on."""
        across, up = x - self.places[:, :1], y - self.places[:, 1:]
        inside: np.ndarray = up[:, :, None] ** 2 + across[:, None] ** 2 <= self.radius**2
        return inside


class Bars(NamedTuple):
    """A bar with round ends in each of n episodes, all of one kind."""

    starts: np.ndarray  # (n, 2), as are ends
    ends: np.ndarray
    radius: float
    colour: Colour

    def cover(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """True for the points ``(n, H, W)`` of a grid with columns ``x (W,)`` and rows ``y (H,)`` that they are on."""
        (along_x, along_y), (start_x, start_y) = (self.ends - self.starts).T[:, :, None], self.starts.T[:, :, None]
        across, up, square = (x - start_x)[:, None], (y - start_y)[:, :, None], along_x**2 + along_y**2
        share = across * (along_x / square)[:, None] + up * (along_y / square)[:, :, None]
        share = np.clip(share, 0, 1)
        off_x, off_y = across - share * along_x[:, None], up - share * along_y[:, :, None]
        inside: np.ndarray = off_x**2 + off_y**2 <= self.radius**2
        return inside


def draw_plane(layers: Sequence[Discs | Bars], reach: float, size: tuple[int, int]) -> np.ndarray:
    """Pictures ``(n, H, W, 3)`` uint8 of layers, later ones on top, from ``-reach`` to ``reach`` on white."""
    height, width = size
    pixel = 2 * reach / min(size)
    x, y = (np.arange(width) + 0.5 - width / 2) * pixel, (height / 2 - 0.5 - np.arange(height)) * pixel
    pictures = np.full((len(layers[0][0]), height, width, 3), 255, dtype=np.uint8)
    for layer in layers:
        pictures[layer.cover(x, y)] = layer.colour
    return pictures
