"""A task's name: that of a library's environment, and the part of its range in which episodes begin.

``door-open-v3`` begins anywhere, ``door-open-v3_x1`` with the door in the second half of its range along x, and
``door-open-v3_x1y0`` in the first half along y, too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from datamodules.errors import ConfigError

PATTERN = re.compile(r"(?P<name>.+?)(?:_(?=[xy])(?:x(?P<x>\d+))?(?:y(?P<y>\d+))?)?")


@dataclass(frozen=True)
class Variant:
    """An environment of a library, and the cell of its range: of so many parts along x and y, the one chosen."""

    name: str
    cell: tuple[int | None, int | None]
    parts: int

    @classmethod
    def of(cls, task: str, parts: int) -> Variant:
        """The variant that a task's name stands for.

        Raises:
            ConfigError: If there are not as many parts.
        """
        found = PATTERN.fullmatch(task)
        if found is None:
            return cls(task, (None, None), parts)
        cell = tuple(None if found[axis] is None else int(found[axis]) for axis in "xy")
        if any(part is not None and part >= parts for part in cell):
            told = f"task {task!r} begins in a part that there is none of; expected 0 to {parts - 1} behind x and y"
            raise ConfigError(f"{told}, or more regions: set regions")
        return cls(found["name"], (cell[0], cell[1]), parts)

    def narrow(self, axis: int, low: float, high: float) -> tuple[float, float]:
        """The cell's part of a range along x, axis 0, or y, axis 1.

        Raises:
            ConfigError: If a part is asked for of what has no extent.
        """
        part = self.cell[axis]
        if part is None:
            return low, high
        if np.isclose(low, high):
            told = f"task {self.name} begins at one {'xy'[axis]} alone"
            raise ConfigError(f"{told}; expected no part of it: leave out {'xy'[axis]}{part} behind its name")
        ends = np.linspace(low, high, self.parts + 1)
        return float(ends[part]), float(ends[part + 1])


def choose(kind: str, name: str, known: Sequence[str], where: str) -> str:
    """The name, if it is one of the library's.

    Raises:
        ConfigError: If it is not, with the one that is nearest.
    """
    if name in known:
        return name
    near = get_close_matches(name, known, n=1, cutoff=0.0)
    few = ", ".join(known) if len(known) <= 30 else f"{known[0]} to {known[-1]}, {len(known)} of them"
    raise ConfigError(
        f"no {kind} {name!r} in {where}; expected one of: {few}" + f"; did you mean {near[0]!r}?" * bool(near)
    )
