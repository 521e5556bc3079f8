"""Tables of a report: success by method, beside a reference's, and what else runs were measured by."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from plp_lightning.report.document import Cell, Section, Table, cell, row
from plp_lightning.report.records import Record
from plp_lightning.report.reference import Reference
from plp_lightning.report.summaries import Group, Measure, Summary, middle, paired, success, summarise, worst_seed
from plp_lightning.report.summaries import by_target as runs_by_target
from plp_lightning.report.words import (
    ABOVE,
    BELOW,
    NONE,
    NOT_SIMULATED,
    NOTED,
    UNRECORDED,
    difference,
    disagreement,
    estimate,
    interval,
    number,
    spread,
    value,
)

KINDS = (
    "Each ± is a standard deviation: over seeds within a target task (pooled), or over target tasks. A 95 % interval "
    "is of the mean over runs (stratified bootstrap) where every target task has two seeds or more, else of the share "
    "of all episodes of these runs (Wilson), which says nothing of other seeds."
)
ONE_KIND = "ours of episodes alone may differ by the seed"


def success_rates(groups: Sequence[Group], compared: Reference) -> Section:
    """Every method on every experiment, beside the reference where that says something of one of them."""
    known = any(compared.value(group.experiment, group.plain_method) for group in groups)
    header = ["experiment", "method", "runs", "success", "95 % interval", "before adaptation", *[compared.name] * known]
    rows = [_success_row(group, compared, known) for group in groups]
    text = "Target task in the target domain, mean over runs."
    return Section("Success rates", [text, KINDS], [Table(header, rows)], notes=_legend(groups, compared, known))


def _success_row(group: Group, compared: Reference, known: bool) -> list[Cell]:
    found, beside = group.summary(), compared.value(group.experiment, group.plain_method)
    rates = [NOT_SIMULATED, NONE] if found is None else [spread(found), interval(found.interval, found.kind)]
    mark = disagreement(found, beside, compared.runs)
    numbers = [counted(group), *rates, spread(group.summary(lambda run: run.before))]
    numbers += [f"{value(beside)} {mark}".rstrip()] * known
    return [*row(group.experiment, group.method), *row(*numbers, runs=group.anchor)]


def counted(group: Group, of: str = "") -> str:
    """Number of a group's runs, ``of`` what it is, and the marks of what is to be said of them."""
    marks = UNRECORDED * (not group.recorded) + NOTED * any(run.note for run in group.records)
    return f"{len(group.records)}{of} {marks}".rstrip()


def _legend(groups: Sequence[Group], compared: Reference, known: bool) -> list[str]:
    unrecorded = any(not group.recorded for group in groups)
    noted = any(run.note for group in groups for run in group.records)
    behind = f" (of {compared.runs} runs, Student's t)" if compared.runs else ""
    return [
        *[f"{UNRECORDED} settings not recorded: these results are older than that record."] * unrecorded,
        *[f"{NOTED} there is something to be said of these runs: see their notes below."] * noted,
        *[f"{ABOVE} above, {BELOW} below: its 95 % interval{behind} and ours share no value; {ONE_KIND}."] * known,
        *[f"{compared.name[:1].upper()}{compared.name[1:]}: {compared.source}."] * (known and bool(compared.source)),
    ]


def interquartile_means(groups: Sequence[Group]) -> list[Section]:
    """Success of groups with two seeds or more of every target task, with the worst seed, and over experiments."""
    repeated = [group for group in groups if (found := group.summary()) and found.middle]
    if not repeated:
        return []
    rows = []
    for group in repeated:
        found = group.summary()
        assert found is not None
        numbers = [str(found.runs), estimate(found.middle), *_over_seeds(found, group.records)]
        rows.append([*row(group.experiment, group.method), *row(*numbers, runs=group.anchor)])
    text = (
        "Mean of the middle half of all runs, and mean of all, with 95 % intervals of the stratified bootstrap; "
        "standard deviation over seeds within a target task (pooled); the worst seed's mean over target tasks."
    )
    header = ["experiment", "method", "runs", "interquartile mean", "mean", "± seeds", "worst seed"]
    return [Section("Over seeds", [text], [Table(header, [*rows, *_over_all(repeated)])])]


def _over_seeds(found: Summary, records: Sequence[Record]) -> list[str]:
    mean = f"{number(found.mean)} ({interval(found.interval)})"
    return [mean, number(found.over_seeds), number(worst_seed(records))]


def _over_all(groups: Sequence[Group]) -> Iterator[list[Cell]]:
    """A row for each method that was run on all of several experiments."""
    experiments = dict.fromkeys(group.experiment for group in groups)
    for method in dict.fromkeys(group.method for group in groups):
        own = [group for group in groups if group.method == method and group.recorded]
        if len(experiments) > 1 and len({group.experiment for group in own}) == len(experiments):
            records = [record for group in own for record in group.records]
            found = summarise(records)
            assert found is not None
            numbers = [str(found.runs), estimate(middle(runs_by_target(records, success)))]
            yield row("all of these", method, *numbers, *_over_seeds(found, records))


def differences(groups: Sequence[Group]) -> list[Section]:
    """Each method against the first of its experiment, on the same target tasks and seeds."""
    first: dict[tuple[str, bool], Group] = {}
    rows = []
    for group in groups:
        base = first.setdefault((group.experiment, group.recorded), group)
        if base is not group and (found := paired(group.records, base.records)):
            names = row(group.experiment, f"{group.method} − {base.method}")
            rows.append([*names, *row(str(found[0]), difference(found[1]), runs=group.anchor)])
    text = "Mean difference of success over runs with the same target task and seed, with Student's 95 % interval."
    table = Table(["experiment", "methods", "pairs", "difference"], rows)
    return [Section("Differences", [text], [table])] if rows else []


def side_by_side(groups: Sequence[Group], compared: Reference) -> list[Section]:
    """A row for each target task and seed that several methods were run on; none without one."""
    rates: dict[tuple[str, str, str], dict[str, Cell]] = defaultdict(dict)
    for group in groups:
        for run in group.records:
            if run.success is not None:
                names = (group.experiment, run.run.target, str(run.run.seed))
                rates[names][group.method] = cell(number(run.success), runs=group.anchor)
    shared = {names: found for names, found in rates.items() if len(found) > 1}
    order = dict.fromkeys([*compared.methods(), *sorted(group.method for group in groups)])
    methods = [name for name in order if any(name in found for found in shared.values())]
    rows = [[*row(*names), *(found.get(name, cell(NONE)) for name in methods)] for names, found in shared.items()]
    table = Table(["experiment", "target", "seed", *methods], rows)
    return [Section("Side by side", ["Methods on the same target task and seed."], [table])] if rows else []


def measured(groups: Sequence[Group], field: str, title: str, text: str, digits: int = 2) -> list[Section]:
    """Means of all numbers of a field of the records; none if no run has any."""
    names = sorted({name for group in groups for run in group.records for name in getattr(run, field)})
    rows = []
    for group in groups:
        found = [group.summary(_entry(field, name)) for name in names]
        if any(found):
            numbers = [str(len(group.records)), *(spread(summary, digits) for summary in found)]
            rows.append([*row(group.experiment, group.method), *row(*numbers, runs=group.anchor)])
    return [Section(title, [text], [Table(["experiment", "method", "runs", *names], rows)])] if names else []


def _entry(field: str, name: str) -> Measure:
    def entry(run: object) -> float | None:
        numbers: Mapping[str, float] = getattr(run, field)
        return numbers.get(name)

    return entry
