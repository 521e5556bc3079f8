"""Observations as a robot gives them, an array by name, and as policies take them, one vector and images by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from datamodules.errors import UserError
from datamodules.types import NO_IMAGES, ArrayT, DomainSpec, Observation, ObservationKey


def gather(spec: DomainSpec, named: Mapping[str, np.ndarray]) -> tuple[Observation[np.ndarray], tuple[int, ...]]:
    """Lay named arrays ``(…, *shape)`` side by side; names that the domain does not know are passed over.

    Returns:
        State ``(B, O)`` float32, images ``(B, H, W, C)`` uint8; and the leading axes, whose product is B.

    Raises:
        UserError: If a key of the domain is missing, or its array is of another shape.
    """
    leads = {key.name: _lead(key, named, spec) for key in spec.observation}
    lead = next(iter(leads.values()))
    if odd := next((name for name, found in leads.items() if found != lead), None):
        first = next(iter(leads))
        raise UserError(f"{odd!r} has {leads[odd]} rows, {first!r} {lead}; expected as many of each key")
    rows = math.prod(lead)
    columns = [np.asarray(named[key.name], np.float32).reshape(rows, *key.shape) for key in spec.state_keys]
    images = {key.name: np.asarray(named[key.name]).reshape(rows, *key.shape) for key in spec.image_keys}
    return Observation(np.concatenate([np.empty((rows, 0), np.float32), *columns], axis=1), images), lead


def fit_images(spec: DomainSpec, observation: Observation[np.ndarray]) -> Observation[np.ndarray]:
    """Hold images ``(B, H, W, C)`` uint8 to a domain's cameras; where there is one, the array alone will do.

    An observation without images is left as it is: a policy may look at none.

    Raises:
        UserError: If images of one camera of several are missing, or of another shape, type or number than states.
    """
    cameras, found = spec.image_keys, observation.images
    if isinstance(found, np.ndarray) and len(cameras) == 1:
        found = {cameras[0].name: found}
    if not isinstance(found, Mapping):
        expected = f"arrays by name, of {', '.join(key.name for key in cameras) or 'none'}"
        raise UserError(f"images are of type {type(found).__name__}; domain {spec.name!r} shows {expected}")
    if not found:
        return observation
    rows = {key.name: _lead(key, found, spec) for key in cameras}
    states = observation.state.shape[:-1]
    if odd := next((name for name, lead in rows.items() if lead != states), None):
        raise UserError(f"{odd!r} has {rows[odd]} rows, the state {states}; expected as many of each")
    return observation._replace(images={key.name: found[key.name] for key in cameras})


def join_observations(
    parts: Sequence[Observation[ArrayT]], join: Callable[[list[ArrayT]], ArrayT]
) -> Observation[ArrayT]:
    """Put observations of one domain together, by ``np.concatenate`` or ``torch.stack`` of their states and images."""
    images = {name: join([part.images[name] for part in parts]) for name in parts[0].images}
    return Observation(join([part.state for part in parts]), images or NO_IMAGES)


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
