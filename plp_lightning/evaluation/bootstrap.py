"""Aggregates over runs of several tasks, as rliable defines them.

See "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (https://arxiv.org/abs/2108.13264).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from datamodules.errors import UserError
from datamodules.streams import Stream, generator

REPETITIONS = 10_000
Statistic = Callable[[np.ndarray], np.ndarray]  # (R, N) → (R,)


def means(values: np.ndarray) -> np.ndarray:
    """Mean of each row ``(R, N)`` as ``(R,)``."""
    return np.asarray(values.mean(axis=1))


def interquartile_means(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of each row ``(R, N)`` as ``(R,)``: the lowest and the highest quarter are left out.

    Example:
        >>> float(interquartile_means(np.array([[0.0, 0.5, 0.7, 1.0]]))[0])
        0.6
    """
    return np.asarray(stats.trim_mean(values, 0.25, axis=1))


def bootstrap_interval(
    tasks: Sequence[Sequence[float]], statistic: Statistic, confidence: float = 0.95
) -> tuple[float, float]:
    """Percentile interval of a statistic of all runs by the stratified bootstrap: runs are drawn anew within each task.

    Args:
        tasks: By task, a value of each of its runs, two or more.
        statistic: What is told of all runs together.
        confidence: Share of intervals that hold the truth.

    Raises:
        UserError: If a task has fewer than two runs: nothing tells how much they differ.
    """
    if not tasks or min(map(len, tasks)) < 2:
        raise UserError("found a task with fewer than two runs; expected two or more: add seeds")
    draws = generator(Stream.RESAMPLED_RUNS)  # the same runs always have the same interval
    drawn = [np.asarray(runs)[draws.integers(len(runs), size=(REPETITIONS, len(runs)))] for runs in tasks]
    found = statistic(np.concatenate(drawn, axis=1))
    low, high = np.percentile(found, [50 * (1 - confidence), 50 * (1 + confidence)])
    return float(low), float(high)
