"""One look for all figures: a palette that the colour-blind can tell apart, markers, lines and sizes."""

from __future__ import annotations

from typing import Any

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
"""Okabe and Ito's palette, in turn (https://jfly.uni-koeln.de/color/)."""
MARKERS = "o^sDvP"  # in turn
LINES = ("-", "--", ":", "-.")  # in turn, after each round of colours
HATCHES = ("", "///", "...", "xxx")  # likewise, of bars
GREY = "0.35"
LOOK: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.5,
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,  # letters stay letters in a PDF
}
"""Settings of matplotlib for the figures of a report."""


def colour(i: int) -> str:
    """Colour of the i-th of several."""
    return COLOURS[i % len(COLOURS)]


def line(i: int) -> str:
    """Line style of the i-th of several; with :func:`colour` it is its own for the first 24."""
    return LINES[i // len(COLOURS) % len(LINES)]


def hatch(i: int) -> str:
    """Hatching of the i-th of several bars; with :func:`colour` it is its own for the first 24."""
    return HATCHES[i // len(COLOURS) % len(HATCHES)]


def marker(i: int) -> str:
    """Marker of the i-th of several."""
    return MARKERS[i % len(MARKERS)]
