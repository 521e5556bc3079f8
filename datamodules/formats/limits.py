"""Limits of actions: from the owner's units to [-1, 1]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from datamodules.errors import ConfigError
from datamodules.formats.mapping import ImportOptions
from datamodules.formats.source import SourceDescription, SourceEpisode
from datamodules.limits import from_owner
from datamodules.types import DomainSpec

ROUNDING = 1e-6  # Farther beyond ±1 than float32 rounds


class ToldLimits(NamedTuple):
    """Values of -1 and 1 in the owner's units, ``(A,)`` each or None, and who says so."""

    low: tuple[float, ...] | None
    high: tuple[float, ...] | None
    told_by: str


def choose_limits(
    source: SourceDescription, options: ImportOptions, known: DomainSpec | None, actions: Sequence[np.ndarray]
) -> ToldLimits:
    """Limits that the options state, that our file has for this domain, that the source tells, or of the values.

    Args:
        source: What is imported.
        options: What the user says.
        known: The domain in our file, if it is there.
        actions: All actions, ``(T, A)`` each.

    Raises:
        ConfigError: If the options state limits of another number or that do not ascend.
    """
    if options.action_low:
        return _plain(_sized(options.action_low, source), _sized(options.action_high, source), "by the options")
    if known is not None and known.action_size == source.action_size:
        return ToldLimits(known.action_low, known.action_high, "as the domain in our file has them")
    if source.action_low is not None and source.action_high is not None:
        return _plain(source.action_low, source.action_high, "as the source tells")
    low, high = (np.min([a.min(0) for a in actions], 0), np.max([a.max(0) for a in actions], 0))
    if source.scaled or (max(-low.min(), high.max()) <= 1 + ROUNDING):
        return ToldLimits(None, None, "none: actions are in [-1, 1]")
    still = low == high
    return ToldLimits(_tuple(low - still), _tuple(high + still), "the least and greatest values there are")


def scale(episode: SourceEpisode, spec: DomainSpec, options: ImportOptions, scaled: bool) -> np.ndarray:
    """Actions ``(T, A)`` float32 in [-1, 1]; a :class:`TrajectoryFileError` names the first beyond the limits."""
    actions = episode.actions.astype(np.float64)
    values = actions.astype(np.float32) if scaled else from_owner(actions, spec.action_limits)
    beyond = np.argwhere(~(np.abs(values) <= 1 + ROUNDING))
    if len(beyond) and not (options.clip_actions and np.isfinite(values).all()):
        step, component = beyond[0].tolist()
        low, high = (-1, 1) if scaled else (limit[component] for limit in spec.action_limits)
        remedy = (
            "add --raw_actions, if they are in the owner's units" if scaled else "state --action_low and --action_high"
        )
        found = f"{actions[step, component]:g} in component {component}"
        episode.refuse("actions", found, f"{low:g} to {high:g}: {remedy}, or add --clip_actions", step)
    return np.clip(values, -1, 1)


def _sized(values: tuple[float, ...], source: SourceDescription) -> tuple[float, ...]:
    if len(values) not in (1, source.action_size):
        raise ConfigError(f"{len(values)} numbers limit {source.action_size} actions; expected as many, or one")
    return values * source.action_size if len(values) == 1 else values


def _plain(low: tuple[float, ...], high: tuple[float, ...], told_by: str) -> ToldLimits:
    unlimited = {*low} == {-1.0} and {*high} == {1.0}
    return ToldLimits(None, None, told_by) if unlimited else ToldLimits(_tuple(low), _tuple(high), told_by)


def _tuple(values: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
