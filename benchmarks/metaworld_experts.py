"""Success of Meta-World's scripted policies in each task: ``python -m benchmarks.metaworld_experts [TASK …]``.

Twenty episodes a task with seeds of their own, each of at most 500 steps; takes a few minutes.
"""

from __future__ import annotations

import sys

from plp_lightning.envs import MetaWorld
from plp_lightning.envs.experts import MetaWorldExpert
from plp_lightning.envs.rollout import rollout

EPISODES = 20


def row(task: str) -> str:
    """A task's line of the table: successes, and the median of the steps that they took."""
    world, expert, tasks, seeds = MetaWorld([task], threads=1), MetaWorldExpert(), [task] * EPISODES, [*range(EPISODES)]
    expert.begin(world, tasks, seeds)
    found = rollout(world, expert.act, tasks, seeds)
    steps = sorted(found.steps[found.success])
    return f"| {task} | {found.success.mean():.2f} | {steps[len(steps) // 2] if steps else '–'} |"


def main() -> None:
    """Print the table, a line as soon as it is measured."""
    from plp_lightning.envs.suites.metaworld_world import NAMES

    print("| task | success | steps |\n|---|---|---|")
    for task in sys.argv[1:] or NAMES:
        print(row(task), flush=True)


if __name__ == "__main__":
    main()
