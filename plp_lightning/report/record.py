"""One run's results, as a report needs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Record:
    """One run's outcome on its target task; success rates are between 0 and 1.

    Attributes:
        success: In the target domain, at the end.
        low: Lower end of its 95 % interval.
        high: Upper end of it.
        before: In the target domain before adaptation; None where what acts was not trained before.
        source: In the source domain, at the end.
        proxy: On proxy tasks in the target domain, at the end.
        alignment: Scores by name, such as ``top5`` or ``closeness``.
        seconds: Time of all phases together, without collecting.
        settings: Settings that differ from the defaults, by dotted key; None if nobody wrote them down.
        behaviour: Further measures of the target task's episodes in the target domain, by name.
    """

    experiment: str
    method: str
    target: str
    seed: int
    success: float
    low: float
    high: float
    before: float | None
    source: float | None
    proxy: float | None
    alignment: Mapping[str, float]
    seconds: float
    settings: Mapping[str, Any] | None = None
    behaviour: Mapping[str, float] = field(default_factory=dict)
