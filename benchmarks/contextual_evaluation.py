"""The time that the contextual policy takes for its episodes, and what its key-value cache saves.

Run from the repository: ``python benchmarks/contextual_evaluation.py [--episodes 100] [--threads 2]``. The policy has
the paper's size and random weights, the maze is PointMaze medium with 400 steps; no episode ends early. Every task's
demonstration is as long as the longest of P2P-medium. Without a cache every step would read the demonstration and the
whole episode again; that is timed at a few steps only.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from datamodules.batches.dataset import build_dataset
from datamodules.problem import TransferProblem
from datamodules.types import Observation, PackedTrajectories
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.envs.rollout import rollout
from plp_lightning.methods import ContextualPolicy

HORIZON, DEMONSTRATION = 400, 266
WITHOUT_CACHE = (100, 200, 300, 400)
"""Steps at which the way without a cache is timed; its cost grows with the step, so their mean is a little high."""


def policy_of(maze: PointMaze) -> ContextualPolicy:
    """A policy with random weights and a random demonstration of every task."""
    domains = [maze.spec("mirrored"), maze.spec("point")]
    policy = ContextualPolicy(TransferProblem(domains, maze.tasks.names, "mirrored", "point"))
    count, rng = len(maze.tasks.names), np.random.default_rng(0)
    state = rng.normal(size=(count * DEMONSTRATION, domains[0].state_size)).astype(np.float32)
    action = rng.uniform(-1, 1, (len(state), domains[0].action_size)).astype(np.float32)
    offset, unknown = np.arange(count + 1) * DEMONSTRATION, np.full(count, -1)
    dataset = build_dataset(domains[0], state, None, action, offset, *[np.arange(count)] * 2, unknown)
    policy.prompts.choose(dataset, {task: task for task in range(count)})
    return policy.eval()


@torch.inference_mode()
def seconds_without_cache(policy: ContextualPolicy, tasks: list[str], steps: int) -> float:
    """Time of the last of so many steps, if it reads everything again."""
    count = len(tasks)
    shown = policy.prompts.of(torch.tensor([policy.tasks[task] for task in tasks]))
    frame = torch.arange(count * steps).view(count, steps)
    seen = Observation(torch.randn(count * steps, policy.target.state_size))
    episodes = PackedTrajectories(seen, frame, torch.ones_like(frame, dtype=torch.bool), torch.empty(0))
    began = time.perf_counter()
    policy(shown, episodes)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    maze = PointMaze("medium", horizon=HORIZON, threads=options.threads)
    policy = policy_of(maze)
    for title, count in (("one task", 1), ("all tasks in turn", len(maze.tasks.names))):
        tasks = [maze.tasks.names[i % count] for i in range(options.episodes)]
        began, used = time.perf_counter(), time.process_time()
        rollout(maze, policy.actor("point", tasks), tasks, list(range(len(tasks))), hold_steps=HORIZON)
        took, used = time.perf_counter() - began, time.process_time() - used
        print(
            f"{title}: {options.episodes} x {HORIZON} steps in {took:.1f} s, {used:.1f} s of processor time", flush=True
        )
    each = np.mean([seconds_without_cache(policy, tasks[:10], steps) for steps in WITHOUT_CACHE])
    print(f"without a cache about {each * options.episodes / 10 * HORIZON:.0f} s")


if __name__ == "__main__":
    main()
