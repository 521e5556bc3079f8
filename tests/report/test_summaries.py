from __future__ import annotations

import math
from statistics import fmean, stdev

import pytest
from test_tables import record

from plp_lightning.evaluation.statistics import success_interval
from plp_lightning.report.reference import Value, paper
from plp_lightning.report.summaries import groups_of, paired, summarise
from plp_lightning.report.words import difference, disagreement, spread

RATES = {("a", 0): 0.5, ("a", 1): 0.7, ("b", 0): 0.9, ("b", 1): 1.0, ("b", 2): 0.8}


def runs(rates, method="plp", **further):
    return [record(method, seed, rate, target=target, **further) for (target, seed), rate in rates.items()]


def test_the_spread_over_seeds_is_within_target_tasks_and_that_over_targets_of_their_means() -> None:
    found = summarise(runs(RATES))
    within = math.sqrt((stdev([0.5, 0.7]) ** 2 + 2 * stdev([0.9, 1.0, 0.8]) ** 2) / 3)
    assert found.mean == pytest.approx(fmean(RATES.values()))
    assert found.over_seeds == pytest.approx(within)
    assert found.over_targets == pytest.approx(stdev([0.6, 0.9]))
    assert (found.runs, found.kind) == (5, "runs")
    low, high = found.interval
    assert low < found.mean < high
    assert found.middle.low <= found.middle.mean <= found.middle.high


@pytest.mark.parametrize(
    "rates", [{("a", 0): 0.5, ("b", 0): 0.9}, {("a", 0): 0.5, ("a", 1): 0.7, ("b", 0): 0.9}, {("a", 3): 0.5}]
)
def test_without_two_seeds_of_every_target_the_interval_is_that_of_episodes(rates) -> None:
    found = summarise(runs(rates))
    assert (found.kind, found.middle) == ("episodes", None)
    if len(rates) > 1:
        assert found.interval == success_interval(round(100 * sum(rates.values())), 100 * len(rates))
    else:
        assert found.interval == (0.25, 0.75)  # as its run stored it
    assert (found.over_seeds is None) == (len({target for target, _ in rates}) == len(rates))


def test_runs_that_do_not_tell_their_episodes_have_no_interval_together() -> None:
    assert summarise(runs({("a", 0): 0.5, ("b", 0): 0.9}, episodes=None)).interval is None
    assert summarise([record(success=None)]) is None


def test_settings_that_nobody_wrote_down_are_a_group_of_their_own() -> None:
    groups = groups_of([record(settings=None), record(seed=1), record(seed=2), record("bc")], paper())
    assert [(group.method, group.recorded, len(group.records)) for group in groups] == [
        *(("plp", False, 1), ("plp", True, 2), ("bc", True, 1)),
    ]
    assert len({group.anchor for group in groups}) == 3


def test_pairs_are_of_the_same_target_and_seed() -> None:
    count, found = paired(runs(RATES), runs({("a", 1): 0.2, ("b", 0): 0.6, ("c", 0): 0.0}, "bc"))
    assert count == 2
    assert found.mean == pytest.approx((0.5 + 0.3) / 2)
    assert found.low < found.mean < found.high
    count, alone = paired(runs(RATES), runs({("a", 1): 0.2}, "bc"))
    assert (count, difference(alone)) == (1, "+0.50")
    assert paired(runs(RATES), runs({("a", 7): 0.2}, "bc")) is None


@pytest.mark.parametrize(
    ("value", "mark"),
    [
        (Value(mean=0.1, low=0.0, high=0.2), "▲"),
        (Value(mean=0.9, low=0.8, high=1.0), "▼"),
        (Value(mean=0.2, low=0.1, high=0.25), ""),  # they touch
        (Value(mean=0.0), ""),  # without an interval nothing disagrees
        (Value(mean=0.1, std=0.1), "▲"),  # 0.02 to 0.18, of nine runs
        (Value(mean=0.1, std=0.5), ""),
        (None, ""),
    ],
)
def test_values_disagree_where_the_intervals_share_no_value(value, mark) -> None:
    assert disagreement(summarise([record()]), value, 9) == mark
    assert disagreement(summarise([record(success=None)]), value, 9) == ""


def test_a_spread_says_of_what_it_is() -> None:
    assert spread(summarise(runs({("a", 0): 0.5}))) == "0.50"
    assert spread(summarise(runs({("a", 0): 0.5, ("a", 1): 0.5}))) == "0.50 ± 0.00 seeds"
    assert spread(summarise(runs({("a", 0): 0.5, ("b", 1): 1.0}))) == "0.75 ± 0.35 targets"
