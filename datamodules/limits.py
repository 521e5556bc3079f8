"""Limits of actions: between [-1, 1], in which policies act, and the units of a robot's owner."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from datamodules.errors import UserError

Limits: TypeAlias = "tuple[tuple[float, ...], tuple[float, ...]]"
"""What -1 and 1 stand for in the owner's units, ``(A,)`` each."""


def check_limits(domain: str, size: int, limits: Limits) -> None:
    """Refuse, by a :class:`UserError`, limits of a domain that are not ``(A,)`` finite numbers that ascend."""
    low, high = limits
    sized = len(low) == len(high) == size
    if not sized or not all(-math.inf < a < b < math.inf for a, b in zip(low, high, strict=True)):
        expected = f"{size} finite numbers each, the lower ones lower"
        raise UserError(f"domain {domain!r} has action limits {low} to {high}; expected {expected}")


def to_owner(actions: np.ndarray, limits: Limits) -> np.ndarray:
    """Actions ``(…, A)`` in [-1, 1] → float64 in the owner's units."""
    low, high = np.array(limits)
    raw: np.ndarray = actions * ((high - low) / 2) + (low + high) / 2
    return raw


def from_owner(actions: np.ndarray, limits: Limits) -> np.ndarray:
    """Inverse of :func:`to_owner`: actions ``(…, A)`` → float32, in [-1, 1] as far as they are within the limits."""
    low, high = np.array(limits)
    scaled: np.ndarray = (actions - (low + high) / 2) / ((high - low) / 2)
    return scaled.astype(np.float32)
