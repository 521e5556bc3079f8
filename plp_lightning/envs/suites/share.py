"""A share of the episodes of a simulator: all of one environment of a library are swapped through one world."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datamodules.streams import start_generator
from datamodules.types import Observation
from plp_lightning.envs.base import Step
from plp_lightning.envs.suites.pictures import Pictures
from plp_lightning.envs.suites.variant import Variant
from plp_lightning.envs.suites.world import Snapshot, World


@dataclass(frozen=True)
class WorldFactory(ABC):
    """All that it takes to make worlds and what they show; plain data, for other processes."""

    origin: str  # Name that joins seeds, so that equal ones don't make the initial states of two domains alike
    regions: int
    cameras: tuple[str, ...]
    view: str  # Camera of films
    image_size: int

    @abstractmethod
    def build(self, name: str) -> World:
        """A world of the library's environment of that name."""

    def share(self) -> WorldShare:
        """Episodes of one process."""
        return WorldShare(self)


@dataclass
class _Running:
    world: World
    pictures: Pictures
    snapshot: Snapshot
    state: np.ndarray  # (O,): what was seen last, as are images (H, W, 3)
    images: list[np.ndarray]


class WorldShare:
    """Episodes of one process, each a snapshot of its world.

    Args:
        factory: Makes worlds.
    """

    def __init__(self, factory: WorldFactory) -> None:
        self.factory, self.episodes = factory, list[_Running]()
        self.worlds: dict[str, tuple[World, Pictures]] = {}  # by the library's name

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes; gives their first observations ``(E, …)``."""
        self.episodes = [self._begin(task, seed) for task, seed in zip(tasks, seeds, strict=True)]
        return self._observed(self.episodes)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step with actions ``(n, A)`` in the episodes ``(n,)``; an invalid one stays as it was."""
        running, finite = [self.episodes[i] for i in episodes], np.isfinite(actions).all(axis=1)
        orders = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)
        told = [
            self._step(one, order) if moves else (False, True)
            for one, order, moves in zip(running, orders, finite.tolist(), strict=True)
        ]
        success, invalid = np.array(told, dtype=np.bool_).reshape(-1, 2).T
        return Step(self._observed(running), success.copy(), invalid.copy())

    def demonstrate(self, episodes: np.ndarray) -> list[np.ndarray]:
        """Actions ``(A,)`` of the library's scripted policy in the episodes ``(n,)``."""
        return [self._in_place(self.episodes[i]).demonstrate() for i in episodes]

    def told(self, episodes: np.ndarray, keys: tuple[str, ...]) -> list[np.ndarray]:
        """All ``(O,)`` that the library shows under these keys in the episodes ``(n,)``."""
        return [self._in_place(self.episodes[i]).told(keys) for i in episodes]

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> list[np.ndarray]:
        """Pictures ``(H, W, 3)`` of the episodes ``(n,)``."""
        drawn = []
        for one in (self.episodes[i] for i in episodes):
            drawn.append(one.pictures.film(self._in_place(one), self.factory.view, size))
        return drawn

    def _begin(self, task: str, seed: int) -> _Running:
        variant = Variant.of(task, self.factory.regions)
        world, pictures = self._world(variant.name)
        world.clear()
        world.begin(variant, start_generator(seed, f"{self.factory.origin} {task}"))
        state, images = world.observe(), pictures.images(world)
        return _Running(world, pictures, world.take(), state, images)

    def _step(self, one: _Running, action: np.ndarray) -> tuple[bool, bool]:
        """Take a step by the action ``(A,)`` in [-1, 1]; tells if the episode is solved, and if it is invalid."""
        world = self._in_place(one)
        try:
            world.act(action)
        except np.linalg.LinAlgError:  # a controller of the library's met a pose that physics had lost
            return False, True
        if not world.sane():
            return False, True
        solved, one.state, one.images = world.solved(), world.observe(), one.pictures.images(world)
        one.snapshot = world.take(one.snapshot)
        return solved, False

    def _in_place(self, one: _Running) -> World:
        one.world.put(one.snapshot)
        return one.world

    def _world(self, name: str) -> tuple[World, Pictures]:
        if name not in self.worlds:
            world = self.factory.build(name)
            self.worlds[name] = world, Pictures(world, self.factory.cameras, self.factory.image_size)
        return self.worlds[name]

    def _observed(self, running: Sequence[_Running]) -> Observation[np.ndarray]:
        names = self.factory.cameras
        images = {name: np.stack([one.images[i] for one in running]) for i, name in enumerate(names)}
        return Observation(np.stack([one.state for one in running]).astype(np.float32), images)
