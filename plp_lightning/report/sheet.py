"""A report's runs and tables as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from datamodules.words import visible
from plp_lightning.report.document import Section
from plp_lightning.report.records import Record, RunKey

MEASURES = ("alignment", "behaviour", "held_out")  # Fields whose every entry is a column
APART = ("run", *MEASURES, "settings", "phases", "folder")
PLAIN = [field.name for field in fields(Record) if field.name not in APART]
FORMULAS = ("=", "+", "-", "@")  # Beginnings that a spreadsheet takes for something to be computed


def comma_separated(records: Sequence[Record]) -> str:
    """A line a run; columns are the fields of :class:`RunKey` and :class:`Record`, and all scores and measures.

    A text that a spreadsheet would compute gets an apostrophe before it, by which spreadsheets know a text.
    """
    measures = [(field, name) for field in MEASURES for name in sorted(_names(records, field))]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    titles = [*RunKey._fields, *PLAIN, *(_column(*measure) for measure in measures), "settings"]
    writer.writerow(map(_safe, titles))
    for record in records:
        cells = [*record.run, *(getattr(record, name) for name in PLAIN)]
        cells += [getattr(record, field).get(name) for field, name in measures]
        settings = "not recorded" if record.settings is None else json.dumps(record.settings)
        writer.writerow(map(_safe, [*cells, settings]))
    return text.getvalue()


def tables_of(sections: Sequence[Section]) -> str:
    """Every table of some sections, all columns, each below its header and behind its section's title."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for section in sections:
        for table in section.tables:
            rows = [table.header, *([" · ".join(cell.lines) for cell in cells] for cells in table.rows)]
            writer.writerows([*map(_safe, [section.title, *cells])] for cells in rows)
    return text.getvalue()


def _safe(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    return visible(f"'{value}" if value.startswith(FORMULAS) else value)


def _column(field: str, name: str) -> str:
    return f"error_{name}" if field == "held_out" else name


def _names(records: Sequence[Record], field: str) -> set[str]:
    return {name for record in records for name in getattr(record, field)}
