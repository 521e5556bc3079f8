"""The beginning of an episode on the table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Layout(NamedTuple):
    """The beginning of one episode."""

    hand: np.ndarray  # start of the hand (3,), m
    furniture: np.ndarray  # places (m, 3) of the balls, or of the window, m
    object: np.ndarray  # position of the puck (3,), or how far the window is open (1,), m
