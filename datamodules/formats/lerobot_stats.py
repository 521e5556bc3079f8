"""Statistics as LeRobot keeps them: least, greatest, mean and spread of every component, of images by channel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Summary:
    """Statistics of a feature, ``(n,)`` each or ``(C, 1, 1)`` of images, that can be joined by ``+``."""

    least: np.ndarray
    greatest: np.ndarray
    mean: np.ndarray
    squares: np.ndarray  # Mean of the squared differences from the mean
    count: int  # Of steps
    weight: int  # Of values a component

    def __add__(self, other: Summary) -> Summary:
        total = self.weight + other.weight
        share = other.weight / total
        mean = self.mean + (other.mean - self.mean) * share
        between = share * (1 - share) * (other.mean - self.mean) ** 2
        squares = self.squares * (1 - share) + other.squares * share + between
        ends = np.minimum(self.least, other.least), np.maximum(self.greatest, other.greatest)
        return Summary(*ends, mean, squares, self.count + other.count, total)

    def plain(self) -> dict[str, Any]:
        """Lists for JSON, under LeRobot's names."""
        told = {"min": self.least, "max": self.greatest, "mean": self.mean, "std": np.sqrt(self.squares)}
        return {name: value.tolist() for name, value in told.items()} | {"count": [self.count]}


def summarise(values: np.ndarray) -> Summary:
    """Statistics of one episode of a feature, ``(T,)``, ``(T, n)`` or images ``(T, H, W, C)`` uint8, as in [0, 1]."""
    if values.ndim == 4:
        return _summarise_images(values)
    rows = values.reshape(len(values), -1).astype(np.float64)
    return Summary(rows.min(0), rows.max(0), rows.mean(0), rows.var(0), len(rows), len(rows))


def _summarise_images(images: np.ndarray) -> Summary:
    """Statistics by channel, from how often each of the 256 levels occurs: a fraction of the images' floats."""
    levels, weight = np.arange(256) / 255, images[..., 0].size
    counts = [np.bincount(images[..., c].ravel(), minlength=256) for c in range(images.shape[3])]
    mean = [float(count @ levels) / weight for count in counts]
    squares = [float(count @ (levels - m) ** 2) / weight for count, m in zip(counts, mean, strict=True)]
    ends = ([levels[count > 0][end] for count in counts] for end in (0, -1))
    least, greatest, means, spreads = (np.array(found).reshape(-1, 1, 1) for found in (*ends, mean, squares))
    return Summary(least, greatest, means, spreads, len(images), weight)
