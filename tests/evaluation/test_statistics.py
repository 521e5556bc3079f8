from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from datamodules.errors import UserError
from plp_lightning.evaluation.statistics import difference_interval, mean_interval, success_interval


def wilson(successes: int, episodes: int, z: float) -> tuple[float, float]:
    rate = successes / episodes
    centre = (rate + z**2 / (2 * episodes)) / (1 + z**2 / episodes)
    width = z / (1 + z**2 / episodes) * math.sqrt(rate * (1 - rate) / episodes + z**2 / (4 * episodes**2))
    return centre - width, centre + width


@pytest.mark.parametrize(("successes", "episodes"), [(0, 10), (9, 10), (50, 100), (100, 100), (1, 1)])
def test_success_interval_is_wilsons(successes: int, episodes: int) -> None:
    assert success_interval(successes, episodes) == pytest.approx(wilson(successes, episodes, 1.959964), abs=1e-6)
    expected = wilson(successes, episodes, 1.644854)
    assert success_interval(successes, episodes, confidence=0.9) == pytest.approx(expected, abs=1e-6)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_success_interval_holds_the_rate_and_is_mirrored_for_failures(counts: tuple[int, int]) -> None:
    successes, episodes = counts
    low, high = success_interval(successes, episodes)
    assert 0 <= low <= successes / episodes + 1e-12
    assert successes / episodes - 1e-12 <= high <= 1
    assert success_interval(episodes - successes, episodes) == pytest.approx((1 - high, 1 - low), abs=1e-12)


def test_without_episodes_any_rate_is_possible() -> None:
    assert success_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "episodes"), [(3, 2), (-1, 5), (1, 0), (0, -1)])
def test_impossible_counts_are_refused(successes: int, episodes: int) -> None:
    with pytest.raises(UserError, match=f"found {successes} successes in {episodes} episodes; expected 0 <= succ"):
        success_interval(successes, episodes)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0])
def test_impossible_confidence_is_refused(confidence: float) -> None:
    with pytest.raises(UserError, match=f"found a confidence of {confidence}; expected a share between 0 and 1"):
        success_interval(1, 2, confidence)
    with pytest.raises(UserError, match="found a confidence"):
        mean_interval([1.0, 2.0], confidence)
    with pytest.raises(UserError, match="found a confidence"):
        difference_interval([1.0, 2.0], [1.0, 2.0], confidence)


def test_mean_interval_by_hand() -> None:
    # Standard deviation 0.1, standard error 0.1 / sqrt(3), and t is 4.302653 for two degrees of freedom.
    width = 4.302653 * 0.1 / math.sqrt(3)
    assert mean_interval([0.8, 0.9, 1.0]) == pytest.approx((0.9, 0.9 - width, 0.9 + width), abs=1e-6)


def test_a_single_run_has_no_interval_and_equal_runs_an_empty_one() -> None:
    single = mean_interval([0.7])
    assert single.mean == 0.7
    assert math.isnan(single.low)
    assert math.isnan(single.high)
    assert mean_interval([0.5, 0.5, 0.5]) == (0.5, 0.5, 0.5)


def test_difference_interval_is_welchs() -> None:
    first, second = [0.9, 0.8, 0.95, 1.0], [0.2, 0.7, 0.4]
    expected = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.9)
    estimate = difference_interval(first, second, confidence=0.9)
    assert estimate == pytest.approx((3.65 / 4 - 1.3 / 3, expected.low, expected.high), rel=1e-9)


def test_difference_of_runs_without_spread_is_sure() -> None:
    assert difference_interval([1.0, 1.0], [0.25, 0.25, 0.25]) == (0.75, 0.75, 0.75)


def test_too_few_and_diverged_values_are_refused() -> None:
    with pytest.raises(UserError, match="found 0 values; expected at least 1: add runs"):
        mean_interval([])
    with pytest.raises(UserError, match="found 1 values; expected at least 2: add runs"):
        difference_interval([1.0, 2.0], [1.0])
    with pytest.raises(UserError, match=r"found \[1\.0, nan\]; expected finite numbers"):
        mean_interval([1.0, math.nan])
