"""A report as LaTeX, with the rules of booktabs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from datamodules.words import one_line
from plp_lightning.report.document import NOT_RUN, Cell, Figure, Section, Table

LONGEST = 30  # Rows of a table on one page
SPECIAL = {
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": r"$<$", ">": r"$>$", "|": r"$|$", '"': "''"},
    **{"±": r"$\pm$", "–": "--", "−": "$-$", "†": r"\dag{}", "‡": r"\ddag{}", "λ": r"$\lambda$"},
    **{
        "▲": r"$\blacktriangle$",
        "▼": r"$\blacktriangledown$",
        "·": r"$\cdot$",
        "×": r"$\times$",
        "[": "{[}",
        "]": "{]}",
    },
}
"""LaTeX's own letters, and ours that its plain fonts lack."""
PREAMBLE = r"""% Compile as it is, or take tables out of it. Names in other scripts want lualatex and a font of theirs.
\documentclass{article}
\usepackage[utf8]{inputenc}
\usepackage{amssymb,booktabs,graphicx,longtable}
\usepackage[margin=2cm,landscape]{geometry}
"""


def latex(title: str, sections: Sequence[Section]) -> str:
    """The whole report; its images are in ``figures/`` beside it."""
    body = (line for section in sections for line in _section(section))
    return "\n".join([PREAMBLE, r"\begin{document}", rf"\title{{{escaped(title)}}}", *body, r"\end{document}", ""])


def escaped(text: str) -> str:
    r"""A text that shows as it is.

    Example:
        >>> print(escaped("p2p_medium 50 % {x}"))
        p2p\_medium 50 \% \{x\}
    """
    return "".join(SPECIAL.get(letter, letter) for letter in one_line(text))


def _section(section: Section) -> Iterator[str]:
    yield rf"\section*{{{escaped(section.title)}}}"
    for paragraph in section.text:
        yield from (escaped(paragraph), "")
    for table in section.tables:
        yield from _table(table)
    for figure in section.figures:
        yield from _figure(figure)
    for paragraph in section.notes:
        yield from (r"\noindent " + escaped(paragraph), "")


def _table(table: Table) -> Iterator[str]:
    kind = "tabular" if len(table.rows) <= LONGEST else "longtable"
    header = [escaped(title) for title in table.header[: table.narrow]]
    yield from ([r"\begin{center}", r"\small"] if kind == "tabular" else [r"{\small"])
    yield rf"\begin{{{kind}}}{{{'l' * len(header)}}}"
    yield from (r"\toprule", _row(header), r"\midrule", *([r"\endhead"] if kind == "longtable" else []))
    yield from (_row([_cell(cell) for cell in cells[: table.narrow]]) for cells in table.rows)
    yield from (r"\bottomrule", rf"\end{{{kind}}}", r"\end{center}" if kind == "tabular" else "}", "")


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _cell(cell: Cell) -> str:
    lines = [*map(escaped, cell.lines)]
    return lines[0] if len(lines) == 1 else r"\shortstack[l]{" + r" \\ ".join(lines) + "}"


def _figure(figure: Figure) -> Iterator[str]:
    yield rf"\subsection*{{{escaped(figure.title)}}}"
    yield from (escaped(figure.text if figure.images else NOT_RUN), "")
    for image in figure.images:
        file = f"figures/{image.name}.{'png' if image.pdf is None else 'pdf'}"
        yield rf"\noindent\includegraphics[width=\linewidth,height=0.8\textheight,keepaspectratio]{{{file}}}"
        yield from ("", escaped(image.caption), "")
