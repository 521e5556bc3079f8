"""Observations as a robot gives them, an array by name, and as policies take them, one vector and one image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation, ObservationKey


def gather(spec: DomainSpec, named: Mapping[str, np.ndarray]) -> tuple[Observation[np.ndarray], tuple[int, ...]]:
    """Lay named arrays ``(…, *shape)`` side by side; names that the domain does not know are passed over.

    Returns:
        State ``(B, O)`` float32, image ``(B, H, W, C)`` uint8 or None; and the leading axes, whose product is B.

    Raises:
        UserError: If a key of the domain is missing, or its array is of another shape.
    """
    leads = {key.name: _lead(key, named, spec) for key in spec.observation}
    lead = next(iter(leads.values()))
    if odd := next((name for name, found in leads.items() if found != lead), None):
        first = next(iter(leads))
        raise UserError(f"{odd!r} has {leads[odd]} rows, {first!r} {lead}; expected as many of each key")
    columns = [np.asarray(named[key.name], np.float32).reshape(-1, *key.shape) for key in spec.state_keys]
    camera = spec.image_key
    image = None if camera is None else np.asarray(named[camera.name]).reshape(-1, *camera.shape)
    return Observation(np.concatenate(columns, axis=1), image), lead


def _lead(key: ObservationKey, named: Mapping[str, np.ndarray], spec: DomainSpec) -> tuple[int, ...]:
    if key.name not in named:
        raise UserError(f"observation lacks {key.name!r}; domain {spec.name!r} shows {', '.join(_names(spec))}")
    found = np.asarray(named[key.name])
    axes = len(key.shape)
    if found.ndim < axes or found.shape[found.ndim - axes :] != key.shape:
        raise UserError(f"{key.name!r} is of shape {found.shape}; expected (…, {', '.join(map(str, key.shape))})")
    if key.kind == "image" and found.dtype != np.uint8:
        raise UserError(f"{key.name!r} is of type {found.dtype}; expected uint8")
    return found.shape[: found.ndim - axes]


def _names(spec: DomainSpec) -> list[str]:
    return [key.name for key in spec.observation]
