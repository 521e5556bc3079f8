from __future__ import annotations

import random
from statistics import fmean

import numpy as np
import pytest

from datamodules.errors import UserError
from plp_lightning.evaluation.bootstrap import bootstrap_interval, interquartile_means, means


def middle_half(values: list[float]) -> float:
    """rliable's definition, of as many values as four divide: the lowest and highest quarter are left out."""
    ordered, quarter = sorted(values), len(values) // 4
    return fmean(ordered[quarter : len(values) - quarter])


@pytest.mark.parametrize("count", [4, 8, 12, 5, 9, 1, 2])
def test_interquartile_means_are_those_of_the_middle_half(count) -> None:
    rows = np.random.default_rng(count).random((3, count))
    assert interquartile_means(rows) == pytest.approx([middle_half(row) for row in rows.tolist()])


@pytest.mark.parametrize(("statistic", "slow"), [(means, fmean), (interquartile_means, middle_half)])
def test_intervals_are_those_of_runs_drawn_anew_within_each_task(statistic, slow) -> None:
    tasks = [[0.1, 0.3, 0.4], [0.7, 0.9, 1.0, 0.6], [0.2, 0.2]]
    dice = random.Random(1)
    drawn = sorted(slow([dice.choice(runs) for runs in tasks for _ in runs]) for _ in range(20_000))
    low, high = bootstrap_interval(tasks, statistic)
    assert (low, high) == pytest.approx((drawn[500], drawn[19_500]), abs=0.02)
    assert bootstrap_interval(tasks, statistic) == (low, high)


def test_tasks_are_strata_whose_difference_widens_nothing() -> None:
    assert bootstrap_interval([[0.0, 0.0], [1.0, 1.0]], means) == (0.5, 0.5)
    low, high = bootstrap_interval([[0.0, 0.0, 1.0, 1.0]], means)
    assert high - low > 0.5


def test_a_higher_confidence_is_a_wider_interval() -> None:
    runs = [list(np.random.default_rng(0).random(20))]
    (low, high), (lower, higher) = (bootstrap_interval(runs, means, share) for share in (0.8, 0.99))
    assert lower < low < high < higher


@pytest.mark.parametrize("tasks", [[], [[0.5]], [[0.5, 0.6], [0.5]]])
def test_a_task_of_one_run_tells_no_interval(tasks) -> None:
    with pytest.raises(UserError, match="fewer than two runs"):
        bootstrap_interval(tasks, means)
