"""A report as LaTeX, with the rules of booktabs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from datamodules.words import one_line
from plp_lightning.report.document import NOT_RUN, Cell, Figure, Section, Table

LONGEST = 30  # Rows of a table on one page
WIDE = 40  # Letters of a cell from which on its column breaks lines
MATHS = {
    **{"±": r"\pm", "−": "-", "·": r"\cdot", "×": r"\times", "→": r"\to", "≤": r"\leq", "≥": r"\geq", "≈": r"\approx"},
    **{"▲": r"\blacktriangle", "▼": r"\blacktriangledown", "<": "<", ">": ">", "|": "|", "∞": r"\infty"},
    **{"α": r"\alpha", "β": r"\beta", "γ": r"\gamma", "δ": r"\delta", "ε": r"\epsilon", "η": r"\eta", "θ": r"\theta"},
    **{"λ": r"\lambda", "μ": r"\mu", "π": r"\pi", "ρ": r"\rho", "σ": r"\sigma", "τ": r"\tau", "φ": r"\phi"},
    **{"ψ": r"\psi", "ω": r"\omega"},
}
SPECIAL = {
    **{letter: f"${command}$" for letter, command in MATHS.items()},
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", '"': "''", "…": r"\dots{}"},
    **{"–": "--", "†": r"\dag{}", "‡": r"\ddag{}", "[": "{[}", "]": "{]}"},
}
"""LaTeX's own letters, and ours that its plain fonts lack."""
PREAMBLE = r"""% Compile as it is, or take tables out of it. Names in other scripts want lualatex and a font of theirs.
\documentclass{article}
\usepackage[utf8]{inputenc}
\usepackage{amssymb,array,booktabs,graphicx,longtable}
\usepackage[margin=2cm,landscape]{geometry}
"""


def latex(title: str, sections: Sequence[Section]) -> str:
    """The whole report; its images are in ``figures/`` beside it."""
    body = (line for section in sections for line in _section(section))
    return "\n".join(
        [PREAMBLE, r"\begin{document}", rf"\section*{{\Large {escaped(title)}}}", *body, r"\end{document}", ""]
    )


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
    yield from ([r"\begin{center}", r"\footnotesize"] if kind == "tabular" else [r"{\scriptsize"])
    yield rf"\begin{{{kind}}}{{{''.join(_columns(table))}}}"
    yield from (r"\toprule", _row(header), r"\midrule", *([r"\endhead"] if kind == "longtable" else []))
    for cells in table.rows:
        yield _row([_cell(cell) for cell in cells[: table.narrow]])
        yield from [r"\addlinespace"] * any(len(cell.lines) > 1 for cell in cells[: table.narrow])
    yield from (r"\bottomrule", rf"\end{{{kind}}}", r"\end{center}" if kind == "tabular" else "}", "")


def _columns(table: Table) -> Iterator[str]:
    """Kind of each column: as wide as its longest text, or one that breaks lines."""
    for i in range(len(table.header[: table.narrow])):
        lines = [line for cells in table.rows for line in cells[i].lines]
        breaks = any(len(line) > WIDE and " " in line for line in lines)
        yield r">{\raggedright\arraybackslash}p{4cm}" if breaks else "l"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _cell(cell: Cell) -> str:
    lines = [*map(escaped, cell.lines)]
    return lines[0] if len(lines) == 1 else r"\begin{tabular}[t]{@{}l@{}}" + r" \\ ".join(lines) + r"\end{tabular}"


def _figure(figure: Figure) -> Iterator[str]:
    yield rf"\subsection*{{{escaped(figure.title)}}}"
    yield from (escaped(figure.text if figure.images else NOT_RUN), "")
    for image in figure.images:
        file = f"figures/{image.name}.{'png' if image.pdf is None else 'pdf'}"
        yield rf"\noindent\includegraphics[width=\linewidth,height=0.8\textheight,keepaspectratio]{{{file}}}"
        yield from ("", escaped(image.caption), "")
