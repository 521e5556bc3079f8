"""Runs that may be averaged, and what they come to: mean, spreads told apart, intervals of their kinds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import NamedTuple

import numpy as np

from plp_lightning.evaluation.bootstrap import bootstrap_interval, interquartile_means, means
from plp_lightning.evaluation.statistics import Estimate, mean_interval, success_interval
from plp_lightning.report.records import Record
from plp_lightning.report.reference import Reference

Measure = Callable[[Record], float | None]
Interval = tuple[float, float]
BOOTSTRAPPED, COUNTED = "runs", "episodes"
"""Kinds of an interval: of the mean over runs, by drawing them anew; of the share of all their episodes alone."""


def success(record: Record) -> float | None:
    """Success rate of the target task in the target domain."""
    return record.success


class Summary(NamedTuple):
    """Outcome of several runs. Spreads are standard deviations; None where too few runs tell them."""

    runs: int
    mean: float
    over_seeds: float | None  # within a target task, pooled; of two seeds or more
    over_targets: float | None  # of the means of two target tasks or more
    interval: Interval | None  # 95 %
    kind: str  # of that interval: BOOTSTRAPPED or COUNTED
    middle: Estimate | None  # interquartile mean with its interval


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of one method on one experiment with the same settings, or of settings that nobody wrote down."""

    experiment: str
    method: str
    recorded: bool  # whether settings are
    records: tuple[Record, ...]
    anchor: str  # its name in a document

    @property
    def recipe(self) -> str | None:
        """Recipe that its runs were made by; None: the page's own settings."""
        return self.records[0].recipe

    @property
    def plain_method(self) -> str:
        """The method's name without the recipe's, by which values are compared with."""
        return self.records[0].plain_method

    def summary(self, measure: Measure = success) -> Summary | None:
        """Outcome of its runs in one measure; None if no run has it."""
        return summarise(self.records, measure)


def groups_of(records: Iterable[Record], order: Reference) -> list[Group]:
    """Groups in the order of a reference; in each, runs by target task and seed."""
    found: dict[tuple[str, str, bool], list[Record]] = defaultdict(list)
    for record in sorted(records, key=lambda run: (_rank(run, order), run.run[2:])):
        found[record.run.experiment, record.run.method, record.settings is not None].append(record)
    return [Group(*names, tuple(runs), f"runs-{i}") for i, (names, runs) in enumerate(found.items(), start=1)]


def _rank(record: Record, order: Reference) -> tuple[object, ...]:
    """Place of a run's experiment, method and recipe; the page's own settings come first."""
    return (*order.rank(record.run.experiment, record.plain_method), record.recipe or "", record.run.method)


def by_target(records: Iterable[Record], measure: Measure) -> dict[tuple[str, str], list[float]]:
    """Values of all runs that have one, by experiment and target task."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for record in records:
        if (value := measure(record)) is not None:
            found[record.run.experiment, record.run.target].append(value)
    return found


def summarise(records: Sequence[Record], measure: Measure = success) -> Summary | None:
    """Mean over runs, spreads and intervals; None if no run has the measure."""
    tasks = by_target(records, measure)
    values = [value for runs in tasks.values() for value in runs]
    if not values:
        return None
    targets, drawn = [fmean(runs) for runs in tasks.values()], _bootstrapped(tasks)
    return Summary(
        runs=len(values),
        mean=fmean(values),
        over_seeds=_over_seeds(tasks),
        over_targets=stdev(targets) if len(targets) > 1 else None,
        interval=drawn or (_counted(records) if measure is success else None),
        kind=BOOTSTRAPPED if drawn else COUNTED,
        middle=middle(tasks),
    )


def middle(tasks: Mapping[tuple[str, str], Sequence[float]]) -> Estimate | None:
    """Interquartile mean of all runs with its bootstrap interval; None if a task has one run alone."""
    if min(map(len, tasks.values()), default=0) < 2:
        return None
    values = np.array([[value for runs in tasks.values() for value in runs]])
    return Estimate(float(interquartile_means(values)[0]), *bootstrap_interval([*tasks.values()], interquartile_means))


def worst_seed(records: Iterable[Record]) -> float | None:
    """Least success of a seed, the mean over its target tasks; None unless two seeds or more have all of these."""
    found: dict[int, dict[tuple[str, str], float]] = defaultdict(dict)
    for record in records:
        if record.success is not None:
            found[record.run.seed][record.run.experiment, record.run.target] = record.success
    tasks = {task for rates in found.values() for task in rates}
    whole = [fmean(rates.values()) for rates in found.values() if rates.keys() == tasks]
    return min(whole) if len(whole) > 1 else None


def paired(first: Iterable[Record], second: Iterable[Record]) -> tuple[int, Estimate] | None:
    """Mean of the first's success less the second's on the same targets and seeds, with Student's interval.

    Returns:
        The number of targets and seeds that both have, and the mean with its interval, whose ends are NaN for one pair
        alone; None if there is no pair.
    """
    rates = [{r.run[2:]: r.success for r in records if r.success is not None} for records in (first, second)]
    shared = sorted({*rates[0]} & {*rates[1]})
    return (len(shared), mean_interval([rates[0][key] - rates[1][key] for key in shared])) if shared else None


def _over_seeds(tasks: Mapping[tuple[str, str], Sequence[float]]) -> float | None:
    repeated = [runs for runs in tasks.values() if len(runs) > 1]
    freedom = sum(len(runs) - 1 for runs in repeated)
    return (sum(stdev(runs) ** 2 * (len(runs) - 1) for runs in repeated) / freedom) ** 0.5 if freedom else None


def _bootstrapped(tasks: Mapping[tuple[str, str], Sequence[float]]) -> Interval | None:
    return bootstrap_interval([*tasks.values()], means) if min(map(len, tasks.values())) > 1 else None


def _counted(records: Sequence[Record]) -> Interval | None:
    """Wilson's interval of all episodes together; that of a single run as it is stored."""
    runs = [record for record in records if record.success is not None]
    if len(runs) == 1:
        low, high = runs[0].low, runs[0].high
        return None if low is None or high is None else (low, high)
    if any(not run.episodes for run in runs):
        return None
    solved = sum(round((run.success or 0.0) * (run.episodes or 0)) for run in runs)
    return success_interval(solved, sum(run.episodes or 0 for run in runs))
