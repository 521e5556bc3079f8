"""A reference's own tables: its value, runs by the recipe that it prints, and ours, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from statistics import fmean

from plp_lightning.report.document import NOT_RUN, Cell, Section, Table, cell, row
from plp_lightning.report.reference import Reference, ReferenceTable, Value
from plp_lightning.report.summaries import Group
from plp_lightning.report.tables import counted
from plp_lightning.report.words import NONE, disagreement, interval, spread, value

HOUR = 3600.0  # s
OURS = "ours"  # Runs with the settings of the experiment's page
MADE_BY = ["sweep page", "commit"]
SEVERAL = 3  # Runs, one for each target task, from which on a mean says something
TEXT = (
    "In each cell: what was measured, its 95 % interval and number of runs. Hours of what was not run are those of "
    "runs of the same method on the same experiment, or else of any method on it."
)


def reference_tables(groups: Sequence[Group], compared: Reference) -> list[Section]:
    """Its tables, from runs; none if no run is of its experiments."""
    if not {group.experiment for group in groups} & {*compared.values}:
        return []
    tables = [_reference_table(groups, compared, table) for table in compared.tables]
    return [_coverage(groups, compared), *tables] if tables else []


def _coverage(groups: Sequence[Group], compared: Reference) -> Section:
    """Count the values that have runs beside them, a row for each recipe."""
    values = [(experiment, method) for experiment, methods in compared.values.items() for method in methods]
    enough = sorted({1, SEVERAL, compared.runs or 1})
    tested = [(group, run) for group in groups for run in group.records if run.success is not None]
    runs = Counter((group.recipe, group.experiment, group.plain_method) for group, _ in tested)
    rows = []
    for recipe in _recipes(compared):
        counts = [sum(runs[recipe, e, method] >= many for e, method in values) for many in enough]
        rows.append(row(recipe or OURS, *map(str, counts)))
    many = ["runs" if least == 1 else f"{least} runs or more" for least in enough]
    title = f"What was run of {len(values)} values of {compared.name}"
    return Section(title, ["Values that have so many runs beside them."], [Table(["by", *many], rows)])


def _reference_table(groups: Sequence[Group], compared: Reference, table: ReferenceTable) -> Section:
    header = ["experiment", "method", compared.name, *(recipe or OURS for recipe in _recipes(compared))]
    rows = []
    for experiment in table.experiments:
        there = [group for group in groups if group.experiment == experiment]
        for method in table.methods:
            beside = compared.value(experiment, method, table)
            rows.append([cell(experiment), cell(method), cell(value(beside)), *_row(there, method, beside, compared)])
    tables = [Table([*header, *MADE_BY], rows, narrow=len(header))]
    return Section(table.title, [TEXT], tables, notes=[table.note] * bool(table.note))


def _recipes(compared: Reference) -> list[str | None]:
    """Recipes whose runs have a column; None: the page's own settings."""
    return [compared.recipe, None] if compared.recipe else [None]


def _row(there: Sequence[Group], method: str, beside: Value | None, compared: Reference) -> list[Cell]:
    """Cells of a method's runs on an experiment: success by recipe, and what they were made by."""
    own = [group for group in there if group.plain_method == method]
    missing = f"{NOT_RUN}: {_hours(own or there, compared.runs)}"
    by_recipe = [[group for group in own if group.recipe == recipe] for recipe in _recipes(compared)]
    runs = [run for groups in by_recipe for group in groups for run in group.records]
    made_by = [_distinct(run.sweep for run in runs), _distinct(run.commit for run in runs)]
    return [*(_measured(groups, beside, compared.runs, missing) for groups in by_recipe), *made_by]


def _measured(groups: Sequence[Group], beside: Value | None, behind: int | None, missing: str) -> Cell:
    lines = list[str]()
    for group in groups:
        if (found := group.summary()) is not None:
            many = counted(group, " run" if len(group.records) == 1 else " runs")
            mean = f"{spread(found)} {disagreement(found, beside, behind)}".rstrip()
            lines += [mean, interval(found.interval, found.kind), many]
    return cell(*(lines or [missing]), runs=groups[0].anchor if groups else "")


def _hours(groups: Sequence[Group], runs: int | None) -> str:
    """Time of so many further runs, as those of the groups took; of one if it is not known how many."""
    seconds = [run.seconds for group in groups for run in group.records]
    many = f"{runs} runs" if runs else "a run"
    return f"{fmean(seconds) * (runs or 1) / HOUR:.1f} h for {many}" if seconds else "hours unknown"


def _distinct(texts: Iterable[str | None]) -> Cell:
    return cell(*(dict.fromkeys(text for text in texts if text) or [NONE]))
