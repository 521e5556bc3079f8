"""Common part of the simulators of robosuite and Meta-World: settings that are checked, and a pool of shares."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import ObservationKey
from plp_lightning.envs.cores import available_processes
from plp_lightning.envs.pool import Pool, PooledSimulator
from plp_lightning.envs.suites.variant import Variant, choose
from plp_lightning.envs.tasks import Tasks

if TYPE_CHECKING:
    from plp_lightning.envs.suites.share import WorldFactory


class Suite(PooledSimulator):
    """Environments of a library by name, stepped by processes in which one environment holds one episode at a time."""

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` from the first camera of the observations, or from the library's usual one."""
        return self._pool.rows("render", episodes, size)

    @abstractmethod
    def _factory(self) -> WorldFactory: ...

    @cached_property
    def _pool(self) -> Pool:
        self.spec("")  # tells what is wrong with names in one line, before processes are started
        return Pool(self._factory(), self.threads or available_processes())

    def _remember(
        self, family: str, tasks: Sequence[str], cameras: Sequence[str], image_size: int, regions: int
    ) -> None:
        kind = type(self).__name__
        if not tasks or len({*tasks}) < len(tasks):
            raise ConfigError(f"{kind}.tasks is {[*tasks]}; expected one name or more, each once")
        if not 8 <= image_size <= 512:
            raise ConfigError(f"{kind}.image_size is {image_size}; expected 8 to 512 pixels")
        self._tasks, self.cameras, self.image_size = Tasks(family, tuple(tasks)), tuple(cameras), image_size
        self.variants, self.regions = [Variant.of(task, regions) for task in tasks], regions

    def _regions_told(self) -> list[str]:
        """The number of regions, if a task begins in one of them."""
        cut = any(variant.cell != (None, None) for variant in self.variants)
        return [f"{self.regions} regions"] * cut

    def _image_keys(self, known: Sequence[str]) -> tuple[ObservationKey, ...]:
        """A key for each camera, all of which have to be among the known."""
        shape = (self.image_size, self.image_size, 3)
        names = [choose("camera", name, known, self.tasks.family) for name in self.cameras]
        return tuple(ObservationKey(name, shape, "image") for name in names)


def pick_keys(
    offered: Sequence[ObservationKey], wanted: Sequence[str] | None, hidden: Sequence[str], where: str
) -> tuple[ObservationKey, ...]:
    """The wanted keys of those that a library offers, in the order of ``wanted``; all but the hidden if None.

    Raises:
        ConfigError: If one is not offered, or twice wanted.
    """
    known = {key.name: key for key in offered}
    if wanted is None:
        return tuple(key for key in offered if key.name not in hidden)
    if len({*wanted}) < len(wanted):
        raise ConfigError(f"state of {where} is {[*wanted]}; expected each key once")
    return tuple(known[choose("state key", name, [*known], where)] for name in wanted)
