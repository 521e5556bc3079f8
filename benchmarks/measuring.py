"""Ratios of ways to do the same, measured in turn so that a busy machine is busy for all, with spread and bar."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

Way = Callable[[], float]
"""Does something and gives the seconds that one of it took."""
Times = Mapping[str, Sequence[float]]
"""Seconds of each way, a value a round."""
SLACK = 2.5
"""A short form fails beyond so many times its bar: it has few rounds, and machines of CI are shared."""


@dataclass(frozen=True)
class Options:
    """Wishes for a benchmark.

    Args:
        short: Few rounds of little, and no more than what CI looks at.
        device: ``cpu`` or ``cuda``.
        robomimic: Python of an environment that has robomimic.
    """

    short: bool = False
    device: str = "cpu"
    robomimic: str | None = None

    def on_gpu(self, limit: float) -> Bar | None:
        """The bar, the greatest that is good, of what is held to it on a GPU alone."""
        return Bar(limit) if self.device == "cuda" else None

    def pick(self, full: int, short: int) -> int:
        """A number of rounds or steps: of the full form or of the short one."""
        return short if self.short else full


class Bar(NamedTuple):
    """The value that a row is held to: the greatest that is good, or the least."""

    limit: float
    least: bool = False

    def holds(self, value: float) -> bool:
        """Tell whether a value is good."""
        return value >= self.limit if self.least else value <= self.limit

    def eased(self, slack: float) -> Bar:
        """The bar for values that may be so many times off."""
        return self._replace(limit=self.limit / slack if self.least else self.limit * slack)

    def __str__(self) -> str:
        return f"{'≥' if self.least else '≤'} {self.limit:g}"


def at_most(limit: float) -> Bar:
    return Bar(limit)


def at_least(limit: float) -> Bar:
    return Bar(limit, least=True)


@dataclass(frozen=True)
class Row:
    """One figure: a median, its first and ninth decile over all rounds, and what it was made of.

    Args:
        name: What is compared with what.
        values: Of each round; none if it was not run.
        unit: Of the values; ``×`` for a ratio.
        bar: What the median is held to.
        seconds: Median of each way's seconds.
        note: Why it was not run, or what else there is to say.
        failed: True if it was to be run and could not be.
    """

    name: str
    values: Sequence[float] = ()
    unit: str = "×"
    bar: Bar | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    failed: bool = False

    @property
    def value(self) -> float:
        return statistics.median(self.values)

    @property
    def spread(self) -> tuple[float, float]:
        """First and ninth decile."""
        if len(self.values) == 1:
            return self.values[0], self.values[0]
        low, *_, high = statistics.quantiles(self.values, n=10, method="inclusive")
        return low, high

    def eased(self, slack: float) -> Row:
        """The same with an easier bar."""
        return replace(self, bar=self.bar and self.bar.eased(slack))

    @property
    def verdict(self) -> str:
        """``ok``, ``missed``, ``failed`` or ``not run``; nothing without a bar."""
        if not self.values:
            return "failed" if self.failed else "not run"
        return "" if self.bar is None else "ok" if self.bar.holds(self.value) else "missed"

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings, for JSON."""
        found = {"median": self.value, "deciles": self.spread} if self.values else {}
        return asdict(self) | {"bar": None if self.bar is None else str(self.bar), **found, "verdict": self.verdict}

    def line(self) -> str:
        """The row of a table."""
        if not self.values:
            return f"{self.name:52} {self.verdict}: {self.note}"
        low, high = map(shown, self.spread)
        spread = f"{shown(self.value)} {self.unit} ({low} to {high})"
        bar = "" if self.bar is None else f"{self.bar} {self.verdict}"
        made = ", ".join(f"{name} {duration(seconds)}" for name, seconds in self.seconds.items())
        return f"{self.name:52} {spread:34} {bar:18} {made}{' · ' * bool(made and self.note)}{self.note}".rstrip()


def shown(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def duration(seconds: float) -> str:
    """Seconds in a unit that suits them."""
    scale, unit = next((pair for pair in ((1.0, "s"), (1e-3, "ms")) if seconds >= pair[0]), (1e-6, "µs"))
    return f"{seconds / scale:.3g} {unit}"


def timed(call: Callable[[], object], count: int = 1, clock: Callable[[], float] = time.perf_counter) -> Way:
    """The way that calls so often and gives the seconds of one call, on the wall or of the processor."""

    def way() -> float:
        began = clock()
        for _ in range(count):
            call()
        return (clock() - began) / count

    return way


def in_turn(ways: Mapping[str, Way], rounds: int, warm: int = 1) -> dict[str, list[float]]:
    """Seconds of each way in so many rounds; ``warm`` rounds come before that count for nothing."""
    times: dict[str, list[float]] = {name: [] for name in ways}
    for turn in range(-warm, rounds):
        for name, way in ways.items():
            taken = way()
            if turn >= 0:
                times[name].append(taken)
    return times


def ratio(name: str, times: Times, over: str, under: str, bar: Bar | None = None, note: str = "") -> Row:
    """The row of ``over``'s seconds divided by ``under``'s, round by round."""
    values = [a / b for a, b in zip(times[over], times[under], strict=True)]
    return Row(name, values, "×", bar, {way: statistics.median(times[way]) for way in (over, under)}, note)
