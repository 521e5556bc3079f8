"""Steps of robosuite's and Meta-World's environments by name, beside the libraries' own loops, one environment stepped.

One process steps first, then all cores: the first ratio is what is left out, the second what processes bring.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.measuring import Options, Row, at_least, in_turn, ratio, timed
from plp_lightning.envs import MetaWorld, Robosuite
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.suites.robosuite_world import library_env
from plp_lightning.envs.suites.setup import Setup

EPISODES = 16
OURS, ALL_CORES, LIBRARY = "one process", "all cores", "the library's step"


def metaworld_env(name: str) -> Any:
    """The library's environment of a task."""
    import metaworld

    env = metaworld.env_dict.ALL_V3_ENVIRONMENTS[name]()
    env.set_task(metaworld.ML1(name).train_tasks[0])
    env.reset()
    env.max_path_length = 1 << 30
    return env


def metaworld(options: Options) -> Iterator[Row]:
    """Three of Meta-World's tasks, whose policies see the hand alone."""
    for name in ("door-open-v3", "pick-place-v3", "hammer-v3")[: options.pick(3, 1)]:
        ways = [MetaWorld([name], objects=False, threads=threads) for threads in (1, 0)]
        yield from _compared(name, ways, metaworld_env(name), 4, options)


def robosuite(options: Options) -> Iterator[Row]:
    """Tasks of robosuite with three robots, their own controllers and all that they show."""
    for name, robot in (("Stack", "Panda"), ("Lift", "Sawyer"), ("Door", "UR5e"))[: options.pick(3, 1)]:
        ways = [Robosuite([name], robot, threads=threads) for threads in (1, 0)]
        env = library_env(Setup((robot,), None, 20, 0.02, ()), name)
        env.reset()
        yield from _compared(f"{name}, {robot}", ways, env, env.action_dim, options)


def _compared(title: str, ours: list[Any], env: Any, size: int, options: Options) -> Iterator[Row]:
    actions = np.random.default_rng(0).uniform(-1, 1, (EPISODES, size)).astype(np.float32)
    for simulator in ours:
        simulator.reset([*simulator.tasks.names] * EPISODES, range(EPISODES))

    def step(simulator: Simulator) -> None:
        simulator.step(actions, np.arange(EPISODES))

    def alone() -> None:
        for action in actions:
            env.step(action)

    ways = {OURS: timed(lambda: step(ours[0])), ALL_CORES: timed(lambda: step(ours[1])), LIBRARY: timed(alone)}
    times = in_turn(ways, options.pick(30, 5), warm=2)  # the first ones compile
    yield ratio(f"{title}: {LIBRARY} / {OURS}", times, LIBRARY, OURS, at_least(2.0))
    yield ratio(f"{title}: {LIBRARY} / {ALL_CORES}", times, LIBRARY, ALL_CORES, at_least(2.0))
