"""The demonstrator of Meta-World: the library's own scripted policies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.suites.metaworld import MetaWorld


class MetaWorldExpert(Expert):
    """Meta-World's scripted policy of each task, clipped to [-1, 1], which is told all that the library shows."""

    def check(self, simulator: Simulator) -> None:
        if not isinstance(simulator, MetaWorld):
            told = f"MetaWorldExpert got simulator {type(simulator).__name__}; expected MetaWorld, pair them so"
            raise ConfigError(told)

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        self.check(simulator)
        assert isinstance(simulator, MetaWorld)
        self._simulator = simulator

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return self._simulator.scripted(episodes)
