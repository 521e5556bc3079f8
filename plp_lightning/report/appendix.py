"""The runs behind all numbers, one a row."""

from __future__ import annotations

import json
from collections.abc import Sequence

from plp_lightning.report.document import Cell, Section, Table, cell, row
from plp_lightning.report.kept import Row
from plp_lightning.report.records import Record
from plp_lightning.report.summaries import Group
from plp_lightning.report.words import NONE, NOT_SIMULATED, interval, named, number

NUMBERS = ["experiment", "method", "target", "seed", "success", "before", "source", "proxies", "alignment"]
ORIGIN = ["settings that differ from the defaults", "commit", "hash of all settings", "hash of the data", "results"]
FURTHER = {"behaviour": ("behaviour", 2), "held_out": ("error of held-out actions", 4), "note": ("note", 0)}
"""Fields that have a column if a run has something in them: its title, and the digits of its numbers."""


def runs(groups: Sequence[Group]) -> Section:
    """Every run: what it came to and, where there is room, what it was made with."""
    records = [(group, record) for group in groups for record in group.records]
    shown = [field for field in FURTHER if any(getattr(record, field) for _, record in records)]
    header = [*NUMBERS, *(FURTHER[field][0] for field in shown)]
    rows = [[*_numbers(record, shown), *_origin(record)] for _, record in records]
    anchors = [group.anchor if record is group.records[0] else "" for group, record in records]
    text = "Success with its 95 % interval; alignment scores on proxy tasks."
    return Section("Runs", [text], [Table([*header, *ORIGIN], rows, anchors, narrow=len(header))])


def _numbers(record: Record, shown: Sequence[str]) -> list[Cell]:
    rate = NOT_SIMULATED
    if record.success is not None:
        ends = None if record.low is None or record.high is None else (record.low, record.high)
        rate = f"{record.success:.2f} ({interval(ends)})"
    others = [number(rate) for rate in (record.before, record.source, record.proxy)]
    return row(*map(str, record.run), rate, *others, named(record.alignment), *(_further(record, f) for f in shown))


def _further(record: Record, field: str) -> str:
    return record.note or NONE if field == "note" else named(getattr(record, field), FURTHER[field][1])


def _origin(record: Record) -> list[Cell]:
    settings = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in (record.settings or {}).items()]
    known = settings or ["none"] if record.settings is not None else ["not recorded"]
    hashes = (record.commit, record.config_sha256, record.data_sha256)
    return [cell(*known), *(cell(text or NONE) for text in hashes), cell(record.file)]


def on_the_way(rows: Sequence[Row]) -> list[Section]:
    """Runs that no table quotes, out of ``runs.csv``; none without one."""
    header = ["name", "experiment", "method", "target", "seed", "success", "settings", "note"]
    text = "Runs of runs.csv whose results.json was not kept; no table above quotes them, none is averaged."
    return (
        [Section("Runs on the way", [text], [Table(header, [row(*(r[c] or NONE for c in header)) for r in rows])])]
        if rows
        else []
    )
