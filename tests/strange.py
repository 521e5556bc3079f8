"""Simulators as strangers write them: with keys of their own, and such as fail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from datamodules.settings import NonNegativeInt
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Step
from plp_lightning.envs.synthetic import LinearPoint


class Keyed(LinearPoint):
    """A point whose state has a key for each of two halves, in the order that is asked for.

    Args:
        map_seed: As of the point.
        keys: Names of the halves.
    """

    def __init__(self, map_seed: NonNegativeInt, keys: Sequence[str] = ("left", "right")) -> None:
        super().__init__(map_seed, 4)
        self.keys = tuple(keys)

    def spec(self, name: str) -> DomainSpec:
        return DomainSpec(name, tuple(ObservationKey(key, (2,)) for key in self.keys), 2, 10.0, "keyed")


class Failing(LinearPoint):
    """A point that does in its n-th step, or in ``reset`` if n is 0, what ``kind`` names.

    Args:
        map_seed: As of the point.
        kind: Name of what happens, a key of :attr:`DEEDS`.
        nth: Step of each episode in which it happens.
        state_size: As of the point.
    """

    def __init__(self, map_seed: NonNegativeInt, kind: str, nth: NonNegativeInt = 3, state_size: int = 7) -> None:
        super().__init__(map_seed, state_size)
        self.kind, self.nth, self.t = kind, nth, 0

    def spec(self, name: str) -> DomainSpec:
        return LinearPoint(self.map_seed, self.state_size).spec(name)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.t, found = 0, super().reset(tasks, seeds)
        return found if self.nth else spoilt(self.kind, found)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        self.t += 1
        found = super().step(actions, episodes)
        return found._replace(**self._spoilt(found)) if self.t == self.nth else found

    def _spoilt(self, found: Step) -> dict[str, Any]:
        if self.kind in STEPS:
            return {STEPS[self.kind][0]: STEPS[self.kind][1](found)}
        return {"observation": spoilt(self.kind, found.observation)}

    RAISED: ClassVar[dict[str, type[BaseException]]] = {
        "raises": RuntimeError,
        "leaves": SystemExit,
        "asserts": AssertionError,
        "divides": ZeroDivisionError,
    }


class Solving(Failing):
    """The same; it solves its first episode in each step before."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        return super().step(actions, episodes)._replace(success=episodes == episodes[0])


def spoilt(kind: str, found: Observation[np.ndarray]) -> Observation[np.ndarray]:
    """The observation after what ``kind`` names, if anything is left of it."""
    if kind in Failing.RAISED:
        raise Failing.RAISED[kind]("mj_step: stack\noverflow")
    return OBSERVATIONS[kind](found)


OBSERVATIONS: dict[str, Any] = {
    "wide states": lambda found: Observation(np.hstack([found.state, found.state])),
    "one state": lambda found: Observation(found.state[0]),
    "double states": lambda found: Observation(found.state.astype(np.float64)),
    "lists": lambda found: Observation(found.state.tolist()),
    "arrays": lambda found: found.state,
    "nothing": lambda found: None,
    "nan": lambda found: Observation(np.full_like(found.state, np.nan)),
}
STEPS: dict[str, Any] = {
    "numbers for success": ("success", lambda found: found.success.astype(np.int64)),
    "one success": ("success", lambda found: np.bool_(True)),
    "column of success": ("success", lambda found: found.success[:, None]),
    "too few invalid": ("invalid", lambda found: found.invalid[:-1]),
}
