"""Facts of robosuite's environments, told by a process of its own and kept: to learn them takes seconds and 300 MB."""

from __future__ import annotations

import contextlib
import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.errors import ConfigError, UserError
from plp_lightning.envs.apart import run_apart
from plp_lightning.envs.kept import kept, origin
from plp_lightning.envs.suites.setup import OBJECT, Setup


@dataclass(frozen=True)
class Facts:
    """All that must be known of an environment before it is stepped."""

    sizes: dict[str, int]  # of what its sensors show, by name
    about_objects: tuple[str, ...]  # names of those that show objects
    cameras: tuple[str, ...]
    action_size: int

    def common(self, other: Facts) -> Facts:
        """Facts that hold for two environments.

        Raises:
            ConfigError: If their actions differ.
        """
        if self.action_size != other.action_size:
            told = f"tasks of a domain take {self.action_size} and {other.action_size} actions"
            raise ConfigError(f"{told}; expected one robot and one controller in all: name tasks that have them")
        sizes = {name: size for name, size in self.sizes.items() if other.sizes.get(name) == size}
        about = tuple(name for name in self.about_objects if name in sizes)
        return Facts(sizes, about, tuple(name for name in self.cameras if name in other.cameras), self.action_size)


@cache
def facts(settings: str) -> Facts:
    """Facts of the environment that settings, as JSON, describe: ``name`` and those of a ``Setup``.

    Raises:
        ConfigError: If robosuite makes no such environment.
    """
    words = hashlib.sha256(settings.encode()).hexdigest()[:16]
    name = f"robosuite_{words}_{origin('robosuite', Path(__file__).parent)}.json"
    found = json.loads(kept(name, partial(_asked, settings)))
    return Facts(found["sizes"], tuple(found["about_objects"]), tuple(found["cameras"]), found["action_size"])


def _asked(settings: str) -> bytes:
    done = run_apart("suites.facts", settings)
    if done.returncode == 2:
        raise ConfigError(done.stdout.decode(errors="replace").strip())
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().split("\n")[-1]
        raise UserError(f"robosuite does not work here: {last}; expected it to be imported: reinstall it")
    return done.stdout


def _learn(settings: dict[str, Any]) -> Facts:
    from plp_lightning.envs.suites.robosuite_world import RobosuiteWorld

    name, words = settings.pop("name"), settings.pop("make")
    world = RobosuiteWorld(Setup(tuple(settings.pop("robots")), make=tuple(words.items()), **settings), name)
    low, high = world.env.action_spec
    if not (np.allclose(low, -1.0) and np.allclose(high, 1.0)):
        told = f"the controller takes actions from {low.min():g} to {high.max():g}"
        raise ConfigError(f"{told}; expected -1 to 1: choose another one, as BASIC is")
    sizes = {key: len(value) for key, value in world.sensed().items()}
    about = [key for key, found in world.env._observables.items() if found.modality == OBJECT]
    cameras = [world.model.camera(i).name for i in range(world.model.ncam)]
    return Facts(sizes, tuple(key for key in about if key in sizes), tuple(cameras), int(world.env.action_dim))


def main(arguments: Sequence[str]) -> int:
    """Write the facts, or else what is wrong with the settings, as the exit code 2 says."""
    with contextlib.redirect_stdout(sys.stderr):
        try:
            told, code = json.dumps(asdict(_learn(json.loads(arguments[0])))), 0
        except UserError as error:
            told, code = str(error), 2
    print(told)
    return code


def described(setup: Setup, name: str) -> str:
    """Settings of an environment as JSON."""
    return json.dumps({"name": name, **asdict(setup), "make": dict(setup.make)}, sort_keys=True, default=str)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
