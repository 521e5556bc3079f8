"""The frame in which a lab states where its robot's hand is, and tells it where to go."""

from __future__ import annotations

import numpy as np

HALF_ANGLE = np.pi / 4  # of a quarter turn


class Frame:
    """A frame that is turned about the vertical axis of the world's, around the same origin.

    Args:
        quarters: Quarter turns, seen from above counterclockwise.
    """

    def __init__(self, quarters: int) -> None:
        self.quarters = quarters % 4

    @property
    def told(self) -> str:
        """Words that end a domain's description; none where nothing is turned."""
        return f", frame turned by {90 * self.quarters}°" if self.quarters else ""

    def stated(self, points: np.ndarray) -> np.ndarray:
        """Points or directions ``(N, 3)`` of the world, as the lab states them."""
        return _turned(points, -self.quarters)

    def meant(self, points: np.ndarray) -> np.ndarray:
        """Points or directions ``(N, 3)`` that the lab states, in the world."""
        return _turned(points, self.quarters)

    def stated_pose(self, quaternions: np.ndarray) -> np.ndarray:
        """Orientations ``(N, 4)``, x, y, z, w, of the world, as the lab states them."""
        x, y, z, w = quaternions.T
        sin, cos = -np.sin(self.quarters * HALF_ANGLE), np.cos(self.quarters * HALF_ANGLE)
        turned: np.ndarray = np.stack([cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z], 1)
        return turned.astype(quaternions.dtype)


def _turned(points: np.ndarray, quarters: int) -> np.ndarray:
    turned: np.ndarray = points.copy()
    for _ in range(quarters % 4):
        turned[:, 0], turned[:, 1] = -turned[:, 1], turned[:, 0].copy()
    return turned
