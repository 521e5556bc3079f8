"""Figures of matplotlib → images of a report, the same bytes each time; bars in panels."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure

from plp_lightning.pictures.style import GREY, LOOK, colour, hatch
from plp_lightning.report.document import Image

DPI = 144
LONGEST = 28  # Letters of a name that are drawn
COLUMNS = 3  # Panels side by side
WIDTH, BAR_HEIGHT, HEAD_HEIGHT = 10.0, 0.22, 0.55  # Of a figure, of a bar, and of a panel's title and axis, in inches


def look() -> AbstractContextManager[None]:
    """The style of all figures, within a block."""
    return rc_context(LOOK)  # type: ignore[arg-type]


def drawn(figure: Figure, name: str, caption: str, runs: str = "") -> Image:
    """An image of a figure; to be called within :func:`look`."""
    png, pdf = io.BytesIO(), io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a box stands for what the font lacks
        FigureCanvasAgg(figure).print_png(png, metadata={"Software": None})  # no version: the same bytes each time
        figure.set_canvas(FigureCanvasPdf(figure))
        figure.savefig(pdf, format="pdf", metadata={"CreationDate": None, "Producer": None, "Creator": None})
    return Image(name, caption, png.getvalue(), round(96 * figure.get_figwidth()), pdf.getvalue(), runs)


class Bar(NamedTuple):
    """A value with its interval, those of single runs, and one to compare with."""

    label: str
    value: float
    ends: tuple[float, float] | None
    runs: Sequence[float]
    beside: float | None = None


def bar_panels(panels: Mapping[str, Sequence[Bar]], order: Sequence[str], beside: str = "") -> Figure:
    """A panel of bars for each title; a label has one colour in all of them.

    Args:
        panels: Bars by title; values are between 0 and 1.
        order: Labels that get the first colours.
        beside: What the values are called that bars are compared with.
    """
    drawn_labels = [bar.label for bars in panels.values() for bar in bars]
    labels = list(dict.fromkeys([*(label for label in order if label in drawn_labels), *drawn_labels]))
    columns = min(COLUMNS, len(panels))
    rows = [list(panels)[i : i + columns] for i in range(0, len(panels), columns)]
    slots = [max(len(panels[title]) for title in row) for row in rows]
    heights = [HEAD_HEIGHT + BAR_HEIGHT * count for count in slots]
    size = (WIDTH * columns / COLUMNS, sum(heights) + 0.3)
    figure = Figure(figsize=size, layout="constrained", dpi=DPI)
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=heights)
    for i, (axes, title) in enumerate(zip(grid.flat, panels, strict=False)):
        _draw_bars(axes, title, panels[title], labels)
        axes.set_ylim(slots[i // columns] - 0.4, -0.6)  # bars of a row are of one height
    for axes in grid.flat[len(panels) :]:
        axes.axis("off")
    _legend(figure, beside if any(bar.beside is not None for bars in panels.values() for bar in bars) else "")
    return figure


def _draw_bars(axes: Axes, title: str, bars: Sequence[Bar], labels: Sequence[str]) -> None:
    for place, bar in enumerate(bars):
        i = labels.index(bar.label)
        axes.barh(place, bar.value, 0.72, color=colour(i), hatch=hatch(i), edgecolor="white", alpha=0.85)
        if bar.ends is not None:
            axes.plot(bar.ends, [place, place], color="black", linewidth=1.2)
        if len(bar.runs) > 1:
            spots = place + np.linspace(-0.2, 0.2, len(bar.runs))
            axes.scatter(bar.runs, spots, s=7, color="white", edgecolors="black", linewidths=0.6, zorder=4)
        if bar.beside is not None:
            axes.scatter(bar.beside, place, s=30, marker="D", color="black", facecolors="none", zorder=5)
    axes.set(xlim=(0, 1.02), title=plain(title))
    axes.set_yticks(range(len(bars)), [plain(bar.label) for bar in bars])
    axes.grid(visible=False, axis="y")
    axes.grid(axis="x")
    axes.tick_params(length=0)


def _legend(figure: Figure, beside: str) -> None:
    told = "line: 95 % interval · circles: runs"
    figure.supxlabel(told + f" · diamond: {plain(beside)}" * bool(beside), fontsize=8, color=GREY)


def plain(text: str) -> str:
    """A text that matplotlib draws as it is, shortened: a dollar sign begins no formula."""
    return (text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…").replace("$", r"\$")
