"""A report before it has a format: sections of text, tables and figures; every text in it is plain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NOT_RUN = "not run"


@dataclass(frozen=True)
class Cell:
    """Lines of a table's cell, and the anchor of the runs behind it."""

    lines: tuple[str, ...]
    runs: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of cells below a header.

    Args:
        header: Titles of the columns.
        rows: A cell for each column.
        anchors: Name of each row that others lead to, empty where none does; may be left away.
        narrow: Number of columns where there is little room: in all formats but HTML. None: all of them.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    anchors: Sequence[str] = ()
    narrow: int | None = None


@dataclass(frozen=True)
class Image:
    """A picture, ``png`` for screens and ``pdf``, if there is one, for paper; ``width`` is that on a screen."""

    name: str  # of its file, without an ending
    caption: str
    png: bytes
    width: int  # in CSS pixels, of which an inch has 96
    pdf: bytes | None = None
    runs: str = ""  # anchor of the runs that it shows


@dataclass(frozen=True)
class Figure:
    """Images that belong together; without any the figure is told as not run."""

    title: str
    text: str
    images: Sequence[Image]


@dataclass(frozen=True)
class Section:
    """A title and what stands below it."""

    title: str
    text: Sequence[str] = ()  # Paragraphs
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    notes: Sequence[str] = ()  # Paragraphs below the tables


def cell(text: str, *lines: str, runs: str = "") -> Cell:
    """A cell of lines."""
    return Cell((text, *lines), runs)


def row(*texts: str, runs: str = "") -> list[Cell]:
    """Cells of one line each; the last ones, which follow the names, lead to the ``runs`` behind them."""
    return [cell(text, runs=runs) for text in texts]
