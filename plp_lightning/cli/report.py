"""``plp report``: results of many runs, side by side."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from datamodules.store.atomic import locked_folder, replacing, write_atomically
from datamodules.words import one_line, visible
from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.yaml_files import read_yaml
from plp_lightning.report.composing import TITLE, figure_section, ordered, table_sections, with_figures
from plp_lightning.report.document import Section
from plp_lightning.report.kept import on_the_way, read_kept, with_notes
from plp_lightning.report.latex import latex
from plp_lightning.report.markdown import markdown
from plp_lightning.report.page import html
from plp_lightning.report.records import Record, read_records
from plp_lightning.report.reference import paper, reference
from plp_lightning.report.sheet import comma_separated, tables_of
from plp_lightning.report.summaries import groups_of


def run_report(arguments: Sequence[str]) -> None:
    """``plp report RUNS… [--out FOLDER] [--reference FILE]``: tables and figures of runs, beside known values."""
    parser = OptionParser("plp report", description="Tables and figures of many runs, beside the paper's values.")
    told = "run directories, or folders above them, such as runs"
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN_DIR", help=told)
    parser.add_argument(
        "--out", type=Path, help="folder that gets report.html, .md, .tex, .csv, tables.csv and figures/"
    )
    parser.add_argument("--reference", type=Path, help="YAML file of values to compare with, instead of the paper's")
    options = parser.parse_args(list(arguments))
    compared = reference(read_yaml(options.reference), options.reference) if options.reference else paper()
    rows, found = read_kept(options.runs), read_records(options.runs)
    records = ordered(groups_of(with_notes(found, rows), compared))
    tables = table_sections(records, on_the_way(records, rows), compared)
    if options.out is None:
        print(visible(markdown(TITLE, tables)), end="")
    else:
        _write(options.out, records, with_figures(tables, figure_section(records, compared, _tell)))


def _write(out: Path, records: Sequence[Record], sections: Sequence[Section]) -> None:
    files: Mapping[str, str] = {
        "report.html": html(TITLE, sections),
        "report.md": markdown(TITLE, sections),
        "report.tex": latex(TITLE, sections),
        "report.csv": comma_separated(records),
        "tables.csv": tables_of(sections),
    }
    (out / "figures").mkdir(parents=True, exist_ok=True)
    _write_images(out / "figures", sections)
    for name, text in files.items():
        write_atomically(out / name, text)
        print(f"{out / name}: {len(records)} run{'s' * (len(records) != 1)}")


def _write_images(folder: Path, sections: Sequence[Section]) -> None:
    images = [image for section in sections for figure in section.figures for image in figure.images]
    for name, content in [(f"{i.name}.png", i.png) for i in images] + [
        (f"{i.name}.pdf", i.pdf) for i in images if i.pdf
    ]:
        with locked_folder(folder), replacing(folder / name) as temporary:
            temporary.write_bytes(content)


def _tell(message: str) -> None:
    print(f"plp: {one_line(message)}", file=sys.stderr)
