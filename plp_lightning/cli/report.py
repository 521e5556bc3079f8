"""``plp report``: results of many runs, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from datamodules.store.atomic import write_atomically
from datamodules.words import visible
from plp_lightning.cli.options import OptionParser
from plp_lightning.report.records import read_records
from plp_lightning.report.tables import comma_separated, markdown


def run_report(arguments: Sequence[str]) -> None:
    """``plp report RUNS… [--out FOLDER]``: success rates of methods and runs beside the paper's."""
    parser = OptionParser("plp report", description="Success rates of methods and runs, beside the paper's.")
    parser.add_argument("runs", type=Path, nargs="+", help="run directories, or folders above them, such as runs")
    parser.add_argument("--out", type=Path, help="folder that gets report.md and report.csv, instead of the screen")
    options = parser.parse_args(list(arguments))
    records = read_records(options.runs)
    if options.out is None:
        print(visible(markdown(records)), end="")
        return
    options.out.mkdir(parents=True, exist_ok=True)
    for name, text in {"report.md": markdown(records), "report.csv": comma_separated(records)}.items():
        write_atomically(options.out / name, text)
        print(f"{options.out / name}: {len(records)} runs")
