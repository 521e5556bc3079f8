"""Settings of an environment of robosuite, apart from robosuite: simulators are built without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

OBJECT = "object"  # all keys of objects one after the other, by the name that robomimic's files give them


@dataclass(frozen=True)
class Setup:
    """Settings of an environment of robosuite; plain data, for other processes."""

    robots: tuple[str, ...]
    controller: str | None
    control_hz: int
    joint_noise: float
    make: tuple[tuple[str, Any], ...]  # further arguments by name
