"""Intervals for a handful of episodes or seeds; ``confidence`` is the share of intervals that hold the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean, stdev
from typing import NamedTuple

from scipy import stats

from datamodules.errors import UserError


class Estimate(NamedTuple):
    """A mean and the interval around it; both bounds are NaN where a single value can't tell."""

    mean: float
    low: float
    high: float


def success_interval(successes: int, episodes: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a success rate: sound at 0 %, at 100 % and for few episodes.

    See "Probable Inference, the Law of Succession, and Statistical Inference"
    (https://doi.org/10.1080/01621459.1927.10502953).

    Returns:
        Lower and upper bound, shares in [0, 1]; with no episodes the rate may be anything.

    Raises:
        UserError: If the counts or the confidence are impossible.

    Example:
        >>> low, high = success_interval(9, 10)
        >>> round(low, 3), round(high, 3)
        (0.596, 0.982)
    """
    _check_confidence(confidence)
    if not 0 <= successes <= episodes:
        raise UserError(f"found {successes} successes in {episodes} episodes; expected 0 <= successes <= episodes")
    if episodes == 0:
        return 0.0, 1.0
    interval = stats.binomtest(successes, episodes).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> Estimate:
    """Mean over independent runs ``(n,)``, such as seeds, with the interval of Student's t.

    Returns:
        The mean and its interval; the bounds are NaN for a single run, and may leave [0, 1] for success rates.

    Raises:
        UserError: If there is no value, one is not finite, or the confidence is impossible.

    Example:
        >>> [round(number, 3) for number in mean_interval([0.8, 0.9, 1.0])]
        [0.9, 0.652, 1.148]
    """
    _check_confidence(confidence)
    _check_values(values, least=1)
    mean = fmean(values)
    if len(values) == 1:
        return Estimate(mean, math.nan, math.nan)
    width = float(stats.t.ppf((1 + confidence) / 2, len(values) - 1)) * stdev(values) / math.sqrt(len(values))
    return Estimate(mean, mean - width, mean + width)


def difference_interval(first: Sequence[float], second: Sequence[float], confidence: float = 0.95) -> Estimate:
    """Mean of ``first`` ``(n,)`` minus mean of ``second`` ``(m,)``, two methods' runs say, with Welch's interval.

    The methods differ at this confidence if the interval leaves out 0. Variances needn't be equal. See "The
    Generalization of 'Student's' Problem when Several Different Population Variances are Involved"
    (https://doi.org/10.1093/biomet/34.1-2.28).

    Raises:
        UserError: If one has fewer than two values, one is not finite, or the confidence is impossible.
    """
    _check_confidence(confidence)
    _check_values(first, least=2)
    _check_values(second, least=2)
    difference = fmean(first) - fmean(second)
    parts = [stdev(values) ** 2 / len(values) for values in (first, second)]
    if not any(parts):
        return Estimate(difference, difference, difference)
    freedom = sum(parts) ** 2 / (parts[0] ** 2 / (len(first) - 1) + parts[1] ** 2 / (len(second) - 1))
    width = float(stats.t.ppf((1 + confidence) / 2, freedom)) * math.sqrt(sum(parts))
    return Estimate(difference, difference - width, difference + width)


def _check_confidence(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise UserError(f"found a confidence of {confidence}; expected a share between 0 and 1, such as 0.95")


def _check_values(values: Sequence[float], least: int) -> None:
    if len(values) < least:
        raise UserError(f"found {len(values)} values; expected at least {least}: add runs, with other seeds")
    if not all(math.isfinite(value) for value in values):
        raise UserError(f"found {list(values)}; expected finite numbers: leave out the runs that diverged")
