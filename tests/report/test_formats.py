"""Texts of others stand in every format as they are: none of them is markup, a formula or a command."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess

import pytest
from samples import NASTY
from test_tables import record

from plp_lightning.report.composing import TITLE, figure_section, table_sections, with_figures
from plp_lightning.report.latex import escaped as escaped_latex
from plp_lightning.report.latex import latex
from plp_lightning.report.markdown import escaped as escaped_markdown
from plp_lightning.report.markdown import markdown
from plp_lightning.report.page import html
from plp_lightning.report.reference import paper
from plp_lightning.report.sheet import comma_separated

BELL = "a\x07\x1b[31m b\n| c"
LETTERS = r"""\&%$#_{}~^<>|"*`[]()!=+-@'"""
PDFLATEX = shutil.which("pdflatex")


def unescaped(text: str) -> str:
    """What Markdown shows of a text that has escapes and entities alone."""
    text = re.sub(r"\\([!-/:-@\[-`{-~])", r"\1", text)
    return text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")


@pytest.mark.parametrize(
    "text", [NASTY, LETTERS, "p2p_medium", "_x_ __init__ a_b", "&lt; &#64;", "<!--", "-->", "![x](y)"]
)
def test_markdown_shows_a_text_as_it_is_and_has_no_markup_of_it(text) -> None:
    told = escaped_markdown(text)
    assert unescaped(told) == text
    assert not re.search(r"<|(?<!\\)[|`*\[$~]|(?<![^\W_]|\\)_|(?<!\\)_(?![^\W_])|&(?!lt;|gt;|amp;)", told)
    assert escaped_markdown("p2p_medium") == "p2p_medium"


def test_every_row_of_markdown_has_as_many_cells_as_its_header() -> None:
    sections = table_sections([record(NASTY, target="a|b"), record("b\\", target="|")], [], paper())
    for block in re.findall(r"(?:^\|.*\n)+", markdown(TITLE, sections), re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)(?:\\\\)*\|", row)) for row in block.splitlines()}) == 1, block


@pytest.mark.parametrize("text", [NASTY, LETTERS])
def test_latex_has_no_letter_of_its_own_from_a_text(text) -> None:
    told = re.sub(r"\\text\w+\{\}|''|\\[&%$#_{}]|\{\[\}|\{\]\}|\$(\\pm|[-<>|])\$|\\d?dag\{\}", "", escaped_latex(text))
    assert not re.search(r"[\\&%$#_{}~^<>|\"\[\]]", told)


def test_latex_is_balanced_and_its_tables_have_the_rules_of_booktabs() -> None:
    text = latex(TITLE, table_sections([record(NASTY), record(NASTY, seed=1)], [], paper()))
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}")
    begun, ended = (sorted(re.findall(rf"\\{word}\{{(\w+)\}}", text)) for word in ("begin", "end"))
    assert begun == ended
    tables = text.count(r"\begin{tabular}{") + begun.count("longtable")
    for rule in ("toprule", "midrule", "bottomrule"):
        assert text.count(rf"\{rule}") == tables > 8


@pytest.mark.skipif(PDFLATEX is None, reason="needs pdflatex (apt-get install texlive-latex-recommended)")
def test_latex_is_typeset(tmp_path) -> None:
    ascii_only = NASTY.encode("ascii", "ignore").decode()
    records = [record(ascii_only), record(LETTERS, seed=1)]
    sections = with_figures(table_sections(records, [], paper()), figure_section(records, paper(), print))
    (tmp_path / "figures").mkdir()
    for image in (image for section in sections for figure in section.figures for image in figure.images):
        (tmp_path / "figures" / f"{image.name}.pdf").write_bytes(image.pdf)
    (tmp_path / "report.tex").write_text(latex(TITLE, sections))
    command = [str(PDFLATEX), "-halt-on-error", "-interaction=nonstopmode", "report.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace", timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@sum(a1)"])
def test_a_spreadsheet_computes_nothing_of_a_text(text) -> None:
    (row,) = csv.DictReader(io.StringIO(comma_separated([record(text, note=text, alignment={text: 0.5}, success=0.5)])))
    assert (row["method"], row["note"], row[f"'{text}"]) == (f"'{text}", f"'{text}", "0.5")


def test_csv_gives_back_what_stood_in_it() -> None:
    (row,) = csv.DictReader(io.StringIO(comma_separated([record(NASTY, note='a "b", c\nd')])))
    assert (row["method"], row["note"]) == (NASTY, 'a "b", c\nd')


def test_no_format_steers_a_terminal_or_fails_at_letters_that_can_not_be_written() -> None:
    odd = record(note=BELL + "\udcff", settings={"a": "\udcff"}, alignment={BELL: 0.5})
    sections = table_sections([odd], [], paper())
    for text in (html(TITLE, sections), markdown(TITLE, sections), latex(TITLE, sections), comma_separated([odd])):
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", text)
        text.encode("utf-8")
