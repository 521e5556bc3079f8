"""Gymnasium's spaces as Minari writes them to JSON, without Gymnasium."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.formats.frames import image_shape
from datamodules.formats.metadata import entry
from datamodules.formats.source import refuse_source

MAX_DEPTH = 6
SMALLEST_JPEG = 32  # Minari keeps smaller images as they are


@dataclass(frozen=True)
class Leaf:
    """A space without parts, somewhere in an observation space."""

    path: tuple[str, ...]  # Names of the spaces that it is in, and its own; empty if it is the whole observation
    shape: tuple[int, ...]
    image: bool
    jpeg: bool
    aside: bool  # No numbers
    tupled: tuple[bool, ...] = ()  # For each name whether it is a position in a tuple

    @property
    def name(self) -> str:
        """Name of the key."""
        return ".".join(self.path) or "observation"

    @property
    def hdf5_path(self) -> tuple[str, ...]:
        """Names of the groups and the array below ``observations``."""
        return tuple(f"_index_{n}" if t else n for n, t in zip(self.path, self.tupled, strict=True))


def find_leaves(
    space: dict[str, Any], place: Path, jpeg: bool, path: tuple[str, ...] = (), tupled: tuple[bool, ...] = ()
) -> Iterator[Leaf]:
    """All leaves of an observation space; a :class:`TrajectoryFileError` says what is no space."""
    kind, parts = entry(space, "type", str, place), space.get("subspaces")
    if len(path) > MAX_DEPTH:
        refuse_source(place, f"spaces in spaces, {len(path)} levels", f"at most {MAX_DEPTH}")
    if kind == "Dict" and isinstance(parts, dict):
        named = [(str(name), part, False) for name, part in parts.items()]
    elif kind == "Tuple" and isinstance(parts, list):
        named = [(str(number), part, True) for number, part in enumerate(parts)]
    else:
        yield _leaf(space, kind, place, jpeg, path, tupled)
        return
    for name, part, is_position in named:
        if not isinstance(part, dict) or "/" in name or not name:
            refuse_source(place, f"the part {name[:50]!r} of a space", "a space under a name")
        yield from find_leaves(part, place, jpeg, (*path, name), (*tupled, is_position))


def _leaf(
    space: dict[str, Any], kind: str, place: Path, jpeg: bool, path: tuple[str, ...], tupled: tuple[bool, ...]
) -> Leaf:
    shape = _shape(space, place) if kind == "Box" else ()
    pixels = space.get("dtype") == "uint8" and _all(space.get("low"), 0) and _all(space.get("high"), 255)
    image = pixels and image_shape(shape)
    encoded = pixels and jpeg and len(shape) in (2, 3) and min(shape[:2]) >= SMALLEST_JPEG
    return Leaf(path, shape, image, encoded, kind not in ("Box", "Discrete") or (encoded and not image), tupled)


def limits_of(space: dict[str, Any], place: Path) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None, int]:
    """Limits ``(A,)`` of an action space, None where they are not finite, and A.

    Raises:
        TrajectoryFileError: If it is no space of vectors.
    """
    kind = entry(space, "type", str, place)
    if kind != "Box" or len(shape := _shape(space, place)) != 1:
        refuse_source(place, f"an action space of type {kind[:50]!r}", "a Box of one axis: our actions are vectors")
    bounds = [_numbers(space.get(name), shape[0], place) for name in ("low", "high")]
    if not all(map(math.isfinite, (*bounds[0], *bounds[1]))) or any(a >= b for a, b in zip(*bounds, strict=True)):
        return None, None, shape[0]
    return bounds[0], bounds[1], shape[0]


def box(shape: tuple[int, ...], dtype: type[np.generic], low: Any = None, high: Any = None) -> dict[str, Any]:
    """A space of arrays; of images if the type is uint8, and without limits if none are given."""
    ends = (0, 255) if dtype is np.uint8 else (-math.inf, math.inf)
    low, high = (np.full(shape, e).tolist() if b is None else b for b, e in zip((low, high), ends, strict=True))
    return {"type": "Box", "dtype": np.dtype(dtype).name, "shape": [*shape], "low": low, "high": high}


def _shape(space: dict[str, Any], place: Path) -> tuple[int, ...]:
    shape = entry(space, "shape", list, place)
    if not all(type(n) is int and 0 < n < 2**31 for n in shape) or len(shape) > 4:
        refuse_source(place, f"the shape {str(shape)[:100]}", "at most four positive numbers")
    return tuple(shape)


def _all(bound: Any, value: int) -> bool:
    while isinstance(bound, list) and bound:
        if any(part != bound[0] for part in bound):
            return False
        bound = bound[0]
    return not isinstance(bound, list) and bound == value


def _numbers(bound: Any, size: int, place: Path) -> tuple[float, ...]:
    values = bound if isinstance(bound, list) else [bound] * size
    if len(values) != size or not all(type(value) in (int, float) for value in values):
        refuse_source(place, f"the limits {str(bound)[:100]}", f"{size} numbers")
    return tuple(map(float, values))
