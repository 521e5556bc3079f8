"""Observations and actions of a Gymnasium environment as arrays of this project: keys by name, actions in [-1, 1]."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import ObservationKey

if TYPE_CHECKING:
    import gymnasium

CHANNELS = (1, 3, 4)


@dataclass(frozen=True)
class Leaf:
    """A space without parts, somewhere in an observation space."""

    path: tuple[str | int, ...]  # Names, or positions in tuples, on the way to it; empty if it is the whole observation
    key: ObservationKey


def find_leaves(space: gymnasium.Space[Any], shown: Sequence[str] | None) -> tuple[Leaf, ...]:
    """The keys that an observation space has, named as an import from Minari names them: ``a.b`` for b in a.

    Args:
        space: Of boxes and whole numbers, and of dictionaries and tuples of them.
        shown: Names of those that are wanted, in their order; all that are numbers if not given.

    Raises:
        ConfigError: If a name is unknown, or there is nothing to show.
    """
    found = {leaf.key.name: leaf for leaf in _leaves(space, ())}
    for name in shown if shown is not None else ():
        if name not in found:
            raise ConfigError(f"Gymnasium.keys names {name!r}; the environment shows: {', '.join(found) or 'nothing'}")
    leaves = tuple(found[name] for name in (shown if shown is not None else found))
    if not leaves:
        raise ConfigError(f"the environment's observations are {space}; expected boxes of numbers, or some by name")
    return leaves


def _leaves(space: Any, path: tuple[str | int, ...]) -> Iterator[Leaf]:
    from gymnasium import spaces

    name = ".".join(map(str, path)) or "observation"
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            yield from _leaves(part, (*path, key))
    elif isinstance(space, spaces.Tuple):
        for position, part in enumerate(space.spaces):
            yield from _leaves(part, (*path, position))
    elif isinstance(space, spaces.Box) and space.dtype == np.uint8 and space.shape[2:] in [(c,) for c in CHANNELS]:
        yield Leaf(path, ObservationKey(name, space.shape, "image"))
    elif isinstance(space, spaces.Box | spaces.MultiBinary | spaces.Discrete | spaces.MultiDiscrete):
        yield Leaf(path, ObservationKey(name, (int(np.prod(space.shape or ())),)))


@dataclass(frozen=True)
class ActionRange:
    """Values that -1 and 1 stand for in an environment's actions, ``(A,)`` each."""

    low: np.ndarray
    high: np.ndarray
    shape: tuple[int, ...] = field(default=())  # The environment's own shape of an action

    @classmethod
    def of(cls, space: gymnasium.Space[Any]) -> ActionRange:
        """The range of an action space.

        Raises:
            ConfigError: If it is no box with finite limits.
        """
        from gymnasium import spaces

        if not isinstance(space, spaces.Box) or not np.isfinite([space.low, space.high]).all():
            expected = "a box with finite limits: wrap it, by gymnasium.wrappers.TransformAction for one"
            raise ConfigError(f"the environment's actions are {space}; expected {expected}")
        return cls(space.low.ravel().astype(np.float64), space.high.ravel().astype(np.float64), space.shape)

    def own(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)``, clipped to [-1, 1], as the environment takes them, ``(n, …)``."""
        middle, half = self._middle_and_half
        scaled: np.ndarray = middle + half * np.minimum(np.maximum(actions, -1), 1)
        return scaled.astype(np.float32).reshape(len(actions), *self.shape)

    @cached_property
    def _middle_and_half(self) -> tuple[np.ndarray, np.ndarray]:
        return (self.high + self.low) / 2, (self.high - self.low) / 2


def gather_states(leaves: Sequence[Leaf], observations: Sequence[Any]) -> np.ndarray:
    """States ``(n, O)`` of observations."""
    count = len(observations)
    parts = [_stacked(leaf, observations).reshape(count, -1) for leaf in leaves if leaf.key.kind == "state"]
    return np.concatenate(parts, axis=1).astype(np.float32) if parts else np.zeros((count, 0), np.float32)


def gather_images(leaves: Sequence[Leaf], observations: Sequence[Any]) -> Mapping[str, np.ndarray]:
    """Images ``(n, H, W, C)`` of observations by name."""
    return {leaf.key.name: _stacked(leaf, observations) for leaf in leaves if leaf.key.kind == "image"}


def _stacked(leaf: Leaf, observations: Sequence[Any]) -> np.ndarray:
    for step in leaf.path:
        observations = [observation[step] for observation in observations]
    return np.array(observations)
