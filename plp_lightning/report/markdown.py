"""A report as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from datamodules.words import one_line
from plp_lightning.report.document import NOT_RUN, Cell, Figure, Section, Table

SPECIAL = re.compile(r"[\\`*\[\]|~$#!]|(?<![^\W_])_|_(?![^\W_])")  # an underscore inside a word is none of Markdown's


def markdown(title: str, sections: Sequence[Section]) -> str:
    """The whole report; its images are in ``figures/`` beside it."""
    return "\n".join([f"# {escaped(title)}", "", *(line for section in sections for line in _section(section))])


def escaped(text: str) -> str:
    r"""A text that shows as it is, on one line.

    Example:
        >>> print(escaped("p2p_medium | <b>*"))
        p2p_medium \| &lt;b&gt;\*
    """
    text = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return SPECIAL.sub(lambda found: "\\" + found[0], text)


def _section(section: Section) -> Iterator[str]:
    yield from (f"## {escaped(section.title)}", "")
    for paragraph in section.text:
        yield from (escaped(paragraph), "")
    for table in section.tables:
        yield from (*_table(table), "")
    for figure in section.figures:
        yield from _figure(figure)
    for paragraph in section.notes:
        yield from (escaped(paragraph), "")


def _table(table: Table) -> Iterator[str]:
    yield _row([escaped(title) for title in table.header[: table.narrow]])
    yield _row(["---"] * len(table.header[: table.narrow]))
    for cells in table.rows:
        yield _row([_cell(cell) for cell in cells[: table.narrow]])


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    return "<br>".join(map(escaped, cell.lines))


def _figure(figure: Figure) -> Iterator[str]:
    yield from (f"### {escaped(figure.title)}", "", escaped(figure.text if figure.images else NOT_RUN), "")
    for image in figure.images:
        yield from (f"![{escaped(image.caption)}](figures/{image.name}.png)", "", escaped(image.caption), "")
