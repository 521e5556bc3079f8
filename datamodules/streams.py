"""Seeds of episodes: each is a pure function of what it is for, so no batch size or order changes it."""

from __future__ import annotations

from zlib import crc32

import numpy as np

MOST_EPISODES = 1 << 24
"""Episodes that one (purpose, seed, domain, task) can have."""


def episode_seed(purpose: str, seed: int, domain: str, task: str, index: int) -> int:
    """Seed of episode ``index`` of a task in a domain; seeds rise with the index.

    So the first n demonstrations of a trajectory file, which sorts by seed, stay the same when it grows.

    Args:
        purpose: ``collect`` or ``evaluate``: what is learned from is not evaluated on.
        seed: Seed of the run or of the collection.
        domain: Name of the domain.
        task: Name of the task.
        index: Which episode of this task.
    """
    entropy = (crc32(purpose.encode()), seed, crc32(domain.encode()), crc32(task.encode()))
    return int(np.random.SeedSequence(entropy).generate_state(1)[0]) * MOST_EPISODES + index
