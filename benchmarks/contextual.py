"""The time that the contextual policy takes for its episodes, and what its key-value cache saves.

The policy has the paper's size and random weights, the maze is PointMaze medium; no episode ends early. Every task's
demonstration is as long as the longest of P2P-medium.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from statistics import mean

import numpy as np
import torch

from benchmarks.measuring import Options, Row, at_least, in_turn, ratio
from datamodules.batches.dataset import build_dataset
from datamodules.problem import TransferProblem
from datamodules.types import Observation, PackedTrajectories
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.envs.rollout import rollout
from plp_lightning.methods import ContextualPolicy

DEMONSTRATION, EPISODES = 266, 10
CACHE, ANEW = "with the cache", "reading all in each step"


def policy_of(maze: PointMaze) -> ContextualPolicy:
    """A policy with random weights and a random demonstration of every task."""
    domains = [maze.spec("mirrored"), maze.spec("point")]
    policy = ContextualPolicy(TransferProblem(domains, maze.tasks.names, "mirrored", "point"))
    count, rng = len(maze.tasks.names), np.random.default_rng(0)
    state = rng.normal(size=(count * DEMONSTRATION, domains[0].state_size)).astype(np.float32)
    action = rng.uniform(-1, 1, (len(state), domains[0].action_size)).astype(np.float32)
    offset, tasks, unknown = np.arange(count + 1) * DEMONSTRATION, np.arange(count), np.full(count, -1)
    dataset = build_dataset(domains[0], state, {}, action, offset, tasks, tasks, unknown)
    policy.prompts.choose(dataset, {task: task for task in range(count)})
    return policy.eval()


@torch.inference_mode()
def seconds_anew(policy: ContextualPolicy, tasks: list[str], steps: int) -> float:
    """Processor's time of the last of so many steps, if it reads everything again."""
    count = len(tasks)
    shown = policy.prompts.of(torch.tensor([policy.tasks[task] for task in tasks]))
    frame = torch.arange(count * steps).view(count, steps)
    seen = Observation(torch.randn(count * steps, policy.target.state_size))
    episodes = PackedTrajectories(seen, frame, torch.ones_like(frame, dtype=torch.bool), torch.empty(0))
    began = time.process_time()
    policy(shown, episodes)
    return time.process_time() - began


def rows(options: Options) -> Iterator[Row]:
    horizon = options.pick(400, 100)
    maze = PointMaze("medium", horizon=horizon, threads=1)
    policy, names = policy_of(maze), maze.tasks.names
    tasks = [names[i % len(names)] for i in range(EPISODES)]

    def cached() -> float:
        began = time.process_time()
        rollout(maze, policy.actor("point", tasks), tasks, [*range(EPISODES)], hold_steps=horizon)
        return time.process_time() - began

    def anew() -> float:  # the cost grows with the step: that of four steps stands for all
        at = [horizon // 8, 3 * horizon // 8, 5 * horizon // 8, 7 * horizon // 8]
        return horizon * mean(seconds_anew(policy, tasks, steps) for steps in at)

    times = in_turn({CACHE: cached, ANEW: anew}, options.pick(3, 1))
    yield ratio(f"{EPISODES} episodes of {horizon} steps: {ANEW} / {CACHE}", times, ANEW, CACHE, at_least(5.0))
