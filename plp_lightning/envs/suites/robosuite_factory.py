"""Factory of robosuite's worlds; robosuite itself is imported where one is."""

from __future__ import annotations

from dataclasses import dataclass

from plp_lightning.envs.suites.setup import Setup
from plp_lightning.envs.suites.share import WorldFactory
from plp_lightning.envs.suites.world import World


@dataclass(frozen=True)
class RobosuiteFactory(WorldFactory):
    """Worlds of robosuite that show these keys."""

    setup: Setup
    spread: float
    turned: bool
    keys: tuple[str, ...]

    def build(self, name: str) -> World:
        from plp_lightning.envs.suites.robosuite_world import RobosuiteWorld

        return RobosuiteWorld(self.setup, name, self.spread, self.keys, self.turned)
