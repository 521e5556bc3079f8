"""Scaling of raw states: fitted once per domain on the alignment data, carried by the policy as buffers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import DomainSpec

Scaling = Literal["zscore", "none"] | float
"""How the columns of one observation key are scaled: to zero mean and unit deviation, left raw, or centred
and multiplied by a number (1/unit). The choice decides success where one unit must be told apart finely."""

CLIP = 5.0  # Bound of z-scored columns, in deviations: a contact's velocity spike must not swamp a layer
DEFAULT_KEY = "default"


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation of a domain's raw states, each float64 of shape ``(O,)``."""

    mean: np.ndarray
    std: np.ndarray

    @classmethod
    def fit(cls, state: np.ndarray) -> Statistics:
        """Statistics of state ``(N, O)``, N ≥ 1."""
        wide = state.astype(np.float64)
        return cls(wide.mean(axis=0), wide.std(axis=0))

    @classmethod
    def identity(cls, size: int) -> Statistics:
        """Zero mean and unit deviation ``(O,)``: a place holder until a checkpoint brings the fitted values."""
        return cls(np.zeros(size), np.ones(size))


@dataclass(frozen=True)
class Affine:
    """``clip((state - offset) * scale, -limit, limit)``, each of shape ``(O,)``."""

    offset: np.ndarray
    scale: np.ndarray
    limit: np.ndarray

    @classmethod
    def build(cls, spec: DomainSpec, statistics: Statistics, scaling: Mapping[str, Scaling]) -> Affine:
        """Scale the columns ``(O,)`` of a domain's states by observation key; ``default`` serves keys without a name.

        Raises:
            ConfigError: If ``scaling`` holds a word that is no scaling.
        """
        offset, scale, limit = np.zeros(spec.state_size), np.ones(spec.state_size), np.full(spec.state_size, np.inf)
        for key in spec.state_keys:
            columns, kind = spec.columns([key.name]), scaling.get(key.name, scaling.get(DEFAULT_KEY, "zscore"))
            if kind == "none":
                continue
            offset[columns] = statistics.mean[columns]
            if kind == "zscore":
                # A column that never changes keeps its raw unit instead of being blown up.
                std = statistics.std[columns]
                scale[columns], limit[columns] = 1 / np.where(std < 1e-6, 1.0, std), CLIP
            elif isinstance(kind, int | float):
                scale[columns] = kind
            else:
                raise ConfigError(f"scaling of {key.name!r} is {kind!r}; expected 'zscore', 'none' or a number")
        return cls(offset, scale, limit)
