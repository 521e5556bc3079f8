"""One environment of a library, and many episodes that are swapped in and out of it.

An environment costs seconds and a hundred megabytes, an episode a row of numbers: its physical state, the places that
the reset gave to bodies of the model, and the attributes of the library's own objects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from typing import Any, NamedTuple

import mujoco
import numpy as np

from plp_lightning.envs.native import DIVERGED, STATE
from plp_lightning.envs.suites.variant import Variant

PLACES = ("body_pos", "body_quat", "site_pos", "geom_rgba")
"""Arrays of a model that the libraries' resets, and some of their steps, write to."""


class Snapshot(NamedTuple):
    """All that an episode consists of while another one is in the environment."""

    state: np.ndarray  # (S,)
    places: tuple[np.ndarray, ...]
    attributes: tuple[dict[str, Any], ...]  # of each of the world's owners


class World(ABC):
    """An environment that holds one episode at a time.

    Args:
        model: The environment's own model; its automatic reset is switched off, since a divergence must be seen.
        data: The environment's own data.
        owners: Its objects that have attributes of an episode.
    """

    rearranges = False  # whether steps, and not resets alone, write to the model
    colliding: int | None = None  # group of geoms that collide, where those to be seen are in others

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, owners: tuple[object, ...]) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.model, self.data, self.owners = model, data, owners
        self._places = tuple(getattr(model, name) for name in PLACES)
        self._moving, self._size = (data.qpos, data.qvel), mujoco.mj_stateSize(model, STATE)
        self._blank = self.take()

    @abstractmethod
    def begin(self, variant: Variant, stream: np.random.Generator) -> None:
        """Begin an episode by the library's own reset, whose random numbers come from ``stream``."""

    @abstractmethod
    def act(self, action: np.ndarray) -> None:
        """Take a control step by the action ``(A,)``."""

    @abstractmethod
    def observe(self) -> np.ndarray:
        """State ``(O,)`` of the keys that are seen."""

    @abstractmethod
    def solved(self) -> bool:
        """True if the library's own check says so."""

    @abstractmethod
    def scene(self) -> mujoco.MjSpec:
        """The model as a specification, for pictures."""

    def told(self, keys: tuple[str, ...]) -> np.ndarray:
        """All ``(O,)`` that the library shows under these keys, whether they are seen or not."""
        raise NotImplementedError

    def demonstrate(self) -> np.ndarray:
        """Action ``(A,)`` of the library's scripted policy."""
        raise NotImplementedError

    def clear(self) -> None:
        """Forget all that earlier episodes left behind."""
        own = tuple({name: _own(value) for name, value in had.items()} for had in self._blank.attributes)
        self.put(self._blank._replace(attributes=own))

    def take(self, before: Snapshot | None = None) -> Snapshot:
        """The episode that the environment holds, which was ``before`` a step ago."""
        state = np.empty(self._size)
        mujoco.mj_getState(self.model, self.data, state, STATE)
        attributes = tuple(dict(vars(owner)) for owner in self.owners)
        if before is None or self.rearranges:
            return Snapshot(state, tuple(array.copy() for array in self._places), attributes)
        return Snapshot(state, before.places, attributes)

    def put(self, episode: Snapshot) -> None:
        """Let the environment hold an episode."""
        for array, kept in zip(self._places, episode.places, strict=True):
            array[:] = kept
        for owner, attributes in zip(self.owners, episode.attributes, strict=True):
            vars(owner).clear()
            vars(owner).update(attributes)
        mujoco.mj_setState(self.model, self.data, episode.state, STATE)

    def sane(self) -> bool:
        """True if the physical state is finite and of a size that physics can have."""
        return all(bool(np.abs(part).max(initial=0.0) < DIVERGED) for part in self._moving)


def _own(value: Any) -> Any:
    """A copy of what holds numbers, so that no two episodes write to one; other objects are shared."""
    if isinstance(value, dict):
        made = copy(value)
        made.update((key, _own(part)) for key, part in value.items())
        return made
    if isinstance(value, list):
        return [_own(part) for part in value]
    return value.copy() if isinstance(value, np.ndarray | set) else value
