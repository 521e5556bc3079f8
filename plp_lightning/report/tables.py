"""Records → Markdown and CSV: methods side by side, and every run."""

from __future__ import annotations

import csv
import io
import json
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path

import yaml

from plp_lightning.report.records import Record, RunKey

Paper = Mapping[str, Mapping[str, tuple[float, float]]]  # Mean and standard deviation by experiment and method
COLUMNS = [field.name for field in fields(Record)]
MEASURES = ("alignment", "behaviour", "held_out")  # Fields whose every entry is a column
NOT_SIMULATED = "not simulated"  # Where a rate would stand, of domains that are known by demonstrations alone
MARK = "†"


@cache
def paper_values() -> Paper:
    """Success rates that the paper reports, in the order in which its tables are read."""
    tables = yaml.safe_load((Path(__file__).parent / "paper.yaml").read_text(encoding="utf-8"))
    return {
        experiment: {name: (x, std) for name, (x, std) in methods.items()} for experiment, methods in tables.items()
    }


def markdown(records: Sequence[Record]) -> str:
    """The report: methods by the mean over their runs, methods on the same target task and seed, and every run."""
    ordered = sorted(records, key=_rank)
    header = ["experiment", "method", "runs", "success", "before adaptation", "the paper"]
    unknown = any(record.settings is None for record in records)
    return "\n".join(
        [
            *("# Success rates", ""),
            *("Target task in the target domain, mean ± standard deviation over runs.", ""),
            *(*_rows(header, _methods(ordered)), ""),
            *([f"{MARK} settings not recorded: these results are older than that record.", ""] if unknown else []),
            *_side_by_side(ordered),
            *("## Runs", "", "Success with its 95 % interval; alignment scores on proxy tasks.", ""),
            *(*_runs(ordered), ""),
        ]
    )


def comma_separated(records: Sequence[Record]) -> str:
    """A line a run; columns are the fields of :class:`RunKey` and :class:`Record`, and all scores and measures."""
    measures = [(field, name) for field in MEASURES for name in sorted(_names(records, field))]
    plain = [name for name in COLUMNS if name not in ("run", *MEASURES, "settings")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*RunKey._fields, *plain, *(_column(*measure) for measure in measures), "settings"])
    for record in sorted(records, key=_rank):
        cells = [*record.run, *(getattr(record, name) for name in plain)]
        cells += [getattr(record, field).get(name) for field, name in measures]
        settings = "not recorded" if record.settings is None else json.dumps(record.settings)
        writer.writerow([*cells, settings])
    return text.getvalue()


def _column(field: str, name: str) -> str:
    return f"error_{name}" if field == "held_out" else name


def _names(records: Sequence[Record], field: str) -> set[str]:
    return {name for record in records for name in getattr(record, field)}


def _rank(record: Record) -> tuple[int, str, int, str, str, int]:
    """Order of the paper; names that it doesn't know come last."""
    experiment, method, target, seed = record.run
    places = (*_place(experiment, [*paper_values()]), *_place(method, [*paper_values().get(experiment, {})]))
    return (*places, target, seed)


def _place(name: str, order: Sequence[str]) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order), name)


def _methods(ordered: Sequence[Record]) -> list[list[str]]:
    groups: dict[tuple[str, str, str], list[Record]] = defaultdict(list)
    for record in ordered:
        groups[record.run.experiment, record.run.method, f" {MARK}" if record.settings is None else ""].append(record)
    rows = []
    for (experiment, method, mark), group in groups.items():
        paper = paper_values().get(experiment, {}).get(method)
        before = [record.before for record in group if record.before is not None]
        success = [record.success for record in group if record.success is not None]
        found = [_spread(success) if success else NOT_SIMULATED, _spread(before), _pair(paper)]
        rows.append([experiment, method, f"{len(group)}{mark}", *found])
    return rows


def _side_by_side(ordered: Sequence[Record]) -> list[str]:
    """A section with a row for each target task and seed that several methods were run on; empty without one."""
    groups: dict[tuple[str, str, str], dict[str, float]] = defaultdict(dict)
    for record in ordered:
        if record.success is not None:
            groups[record.run.experiment, record.run.target, str(record.run.seed)][record.run.method] = record.success
    shared = {names: rates for names, rates in groups.items() if len(rates) > 1}
    if not shared:
        return []
    order = [*dict.fromkeys(name for methods in paper_values().values() for name in methods)]
    methods = sorted({name for rates in shared.values() for name in rates}, key=lambda name: _place(name, order))
    rows = [[*names, *(_rate(rates.get(method)) for method in methods)] for names, rates in shared.items()]
    table = _rows(["experiment", "target", "seed", *methods], rows)
    return ["## Side by side", "", "Methods on the same target task and seed.", "", *table, ""]


def _spread(rates: Sequence[float]) -> str:
    if len(rates) > 1:
        return _pair((statistics.mean(rates), statistics.stdev(rates)))
    return _rate(rates[0] if rates else None)


def _pair(values: tuple[float, float] | None) -> str:
    return "–" if values is None else f"{values[0]:.2f} ± {values[1]:.2f}"


def _rate(rate: float | None) -> str:
    return "–" if rate is None else f"{rate:.2f}"


def _runs(ordered: Sequence[Record]) -> list[str]:
    header = ["experiment", "method", "target", "seed", "success", "before", "source", "proxies", "alignment"]
    further = {"behaviour": "behaviour", "held_out": "error of held-out actions"}
    shown = {field: title for field, title in further.items() if _names(ordered, field)}
    return _rows([*header, *shown.values()], [_run(record, [*shown]) for record in ordered])


def _run(record: Record, measures: Sequence[str]) -> list[str]:
    success = NOT_SIMULATED
    if record.success is not None:
        success = f"{record.success:.2f} ({record.low:.2f} – {record.high:.2f})"
    others = [_rate(rate) for rate in (record.before, record.source, record.proxy)]
    digits = [(field, 4 if field == "held_out" else 2) for field in ("alignment", *measures)]
    return [*map(str, record.run), success, *others, *(_named(getattr(record, field), n) for field, n in digits)]


def _named(values: Mapping[str, float], digits: int) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in values.items()) or "–"


def _rows(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows)]
