"""100 episodes of Gymnasium's environments through our adapter, beside plain processes that do nothing else.

There are as many plain processes as cores. Each makes one environment and runs its share of the episodes in it, one
after the other, with the same random actions.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from multiprocessing.connection import Connection

import numpy as np

from benchmarks.measuring import Options, Row, at_most, in_turn, ratio, timed
from datamodules.types import Observation
from plp_lightning.envs.cores import available_cores
from plp_lightning.envs.gym.simulator import Gymnasium
from plp_lightning.envs.rollout import rollout

EPISODES, TASK = 100, "task"
OURS, PLAIN = "through the adapter", "own steps"


def rows(options: Options, env: str, horizon: int, rounds: int) -> Iterator[Row]:
    """Episodes in processes that are there, and from their start: environments are made anew."""
    title, rounds = f"{EPISODES} episodes, {env.partition(':')[2] or env}", options.pick(rounds, 2)
    ours, plain = through(env, horizon), Plain(env, horizon)
    times = in_turn({OURS: timed(lambda: run(ours)), PLAIN: timed(plain.run)}, rounds)
    yield ratio(f"{title}: {OURS} / {PLAIN}", times, OURS, PLAIN, at_most(1.2))
    plain.end()
    if not options.short:
        times = in_turn(
            {OURS: timed(lambda: run(through(env, horizon))), PLAIN: timed(lambda: Plain(env, horizon).run().end())},
            max(2, rounds // 4),
        )
        yield ratio(f"{title}, from the start: {OURS} / {PLAIN}", times, OURS, PLAIN, at_most(1.2))


def through(env: str, horizon: int) -> Gymnasium:
    return Gymnasium(env, {TASK: {}}, horizon=horizon)


def run(simulator: Gymnasium) -> None:
    """100 episodes of random actions."""
    rng, size = np.random.default_rng(0), simulator.spec("").action_size

    def act(seen: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
        return rng.uniform(-1, 1, (len(running), size))

    rollout(simulator, act, [TASK] * EPISODES, range(EPISODES))


class Plain:
    """Processes that know Gymnasium alone."""

    def __init__(self, env: str, horizon: int) -> None:
        context, count = multiprocessing.get_context("spawn"), available_cores()
        self.pipes: list[Connection] = []
        for i in range(count):
            here, there = context.Pipe()
            seeds = range(EPISODES)[i::count]
            context.Process(target=serve, args=(there, env, horizon, seeds), daemon=True).start()
            self.pipes.append(here)

    def run(self) -> Plain:
        """All episodes."""
        for pipe in self.pipes:
            pipe.send(True)
        for pipe in self.pipes:
            pipe.recv()
        return self

    def end(self) -> None:
        """Let the processes end."""
        for pipe in self.pipes:
            pipe.send(False)
            pipe.close()


def serve(pipe: Connection, name: str, horizon: int, seeds: range) -> None:
    """Run these episodes whenever it is asked for."""
    import gymnasium

    env = gymnasium.make(name, disable_env_checker=True, render_mode="rgb_array")
    low, high, rng = env.action_space.low, env.action_space.high, np.random.default_rng(0)  # type: ignore[attr-defined]
    while pipe.recv():
        for seed in seeds:
            env.reset(seed=seed)
            actions = rng.uniform(low, high, (horizon, len(low))).astype(np.float32)
            for action in actions:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    break
        pipe.send(None)
