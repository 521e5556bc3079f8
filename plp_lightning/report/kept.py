"""``runs.csv``: notes on kept results, and runs on the way whose ``results.json`` was not kept."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from datamodules.words import one_line
from plp_lightning.report.records import Record

NAME = "runs.csv"
COLUMNS = ("name", "experiment", "method", "target", "seed", "success", "settings", "note")  # Those that are read
Row = Mapping[str, str]


def read_kept(paths: Sequence[Path]) -> list[Row]:
    """Rows of every ``runs.csv`` below some folders; files of that name that hold something else are passed over."""
    files = sorted({file.resolve() for path in paths if path.is_dir() for file in path.rglob(NAME) if file.is_file()})
    return [row for file in files for row in _rows(file)]


def with_notes(records: Sequence[Record], rows: Sequence[Row]) -> list[Record]:
    """Records with the notes of their rows, which are named ``experiment/method/target``."""
    notes = {(row["name"], row["seed"]): one_line(row["note"]) for row in rows}
    return [dataclasses.replace(record, note=notes.get(_name(record), "")) for record in records]


def on_the_way(records: Sequence[Record], rows: Sequence[Row]) -> list[Row]:
    """Rows of runs that no record stands for."""
    known = {_name(record) for record in records}
    return [row for row in rows if (row["name"], row["seed"]) not in known]


def _name(record: Record) -> tuple[str, str]:
    return "/".join(record.run[:3]), str(record.run.seed)


def _rows(file: Path) -> list[Row]:
    try:
        with file.open(newline="", encoding="utf-8") as opened:
            rows = list(csv.DictReader(opened))
    except (OSError, UnicodeDecodeError, csv.Error):
        return []
    return [row for row in rows if all(isinstance(row.get(column), str) for column in COLUMNS)]
