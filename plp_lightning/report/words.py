"""Numbers as a report writes them: every spread says of what it is, and nothing stands for what was not measured."""

from __future__ import annotations

import math
from collections.abc import Mapping

from plp_lightning.evaluation.statistics import Estimate
from plp_lightning.report.reference import Value
from plp_lightning.report.summaries import Interval, Summary

NOT_SIMULATED = "not simulated"  # Where a rate would stand, of domains that are known by demonstrations alone
NONE = "–"
UNRECORDED, NOTED, ABOVE, BELOW = "†", "‡", "▲", "▼"


def number(value: float | None, digits: int = 2) -> str:
    """A number, or a dash."""
    return NONE if value is None else f"{value:.{digits}f}"


def signed(value: float) -> str:
    """A difference with its sign; none is without one."""
    return f"{value:+.2f}".replace("-", "−") if round(value, 2) else "0.00"


def spread(summary: Summary | None, digits: int = 2) -> str:
    """Mean and standard deviations, each with its kind.

    Example:
        >>> spread(Summary(4, 0.5, 0.1, 0.25, None, "runs", None))
        '0.50 ± 0.10 seeds ± 0.25 targets'
    """
    if summary is None:
        return NONE
    parts = {"seeds": summary.over_seeds, "targets": summary.over_targets}
    told = [f"± {std:.{digits}f} {kind}" for kind, std in parts.items() if std is not None]
    return " ".join([number(summary.mean, digits), *told])


def interval(ends: Interval | None, kind: str = "") -> str:
    """Both ends of an interval, and what it is of."""
    return NONE if ends is None else f"{ends[0]:.2f} – {ends[1]:.2f} {kind}".rstrip()


def estimate(found: Estimate | None) -> str:
    """A number and its interval, as far as it has one."""
    if found is None:
        return NONE
    return number(found.mean) + ("" if math.isnan(found.low) else f" ({found.low:.2f} – {found.high:.2f})")


def difference(found: Estimate) -> str:
    """A difference and its interval, as far as it has one."""
    ends = "" if math.isnan(found.low) else f" ({signed(found.low)} – {signed(found.high)})"
    return signed(found.mean) + ends


def named(values: Mapping[str, float], digits: int = 2) -> str:
    """Numbers with their names, or a dash."""
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in values.items()) or NONE


def value(known: Value | None) -> str:
    """A value to compare with, its spread over runs or else its interval."""
    if known is None:
        return NONE
    if known.std is not None:
        return f"{known.mean:.2f} ± {known.std:.2f}"
    ends = known.interval(None)
    return number(known.mean) + (f" ({interval(ends)})" if ends else "")


def disagreement(summary: Summary | None, known: Value | None, runs: int | None) -> str:
    """A mark where the interval lies above or below that of a known value; empty where they meet or one has none."""
    ends = known.interval(runs) if known else None
    if summary is None or summary.interval is None or ends is None:
        return ""
    low, high = summary.interval
    return ABOVE if low > ends[1] else BELOW if high < ends[0] else ""
