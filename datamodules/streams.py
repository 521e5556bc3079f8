"""STREAMS: every random number outside torch is drawn from one that is named here, and no two are the same.

A stream's numbers are a function of its key alone, so no batch size, order or interruption changes them. numpy pads
short keys with zeros and cuts numbers above 32 bits into two: (1, 5, 2) and (1, 5, 2, 0) would give the same numbers.
So each stream begins its key with a number of its own, and its keys always have the same parts.

Two kinds of things bring a seed of their own instead: episodes, see :func:`episode_generator`, and what belongs to no
run, the maps of the synthetic domains and the training of a gait, whose seed is their whole key.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Literal
from zlib import crc32

import numpy as np

Purpose = Literal["collect", "evaluate", "score"]  # Uses of episodes: what is learned from is not evaluated on
MOST_EPISODES = 1 << 24  # Episodes that one (purpose, seed, domain, task) can have


class Stream(Enum):
    """Purposes of a run's random numbers: the number that a stream's key begins with, and the names of its parts."""

    VAL_SPLIT = 0, "trajectories"  # Trajectories that are held out, of so many
    ALIGNMENT_ROWS = 1, "seed", "epoch", "domain"  # Steps of a domain in the batches of an epoch
    PAIRS = 2, "seed", "epoch", "step"  # Trajectory pairs of a training step
    MIX = 3, "seed", "epoch"  # Alignment steps mixed into an epoch of adaptation, and the order of both
    BATCH_TASKS = 4, "seed", "epoch"  # Tasks of each batch of an epoch, where batches hold few
    SCORED_STATES = 7, "domain"  # States whose alignment is scored
    GUIDED_STATES = (8,)  # The same, of episodes that a guide shows for the score alone
    PROXY_GOALS = (11,)  # Order in which goals become proxy tasks
    RESAMPLED_RUNS = (12,)  # Runs that stand for others in an interval over runs

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the numbers that follow in its keys."""
        return tuple(map(str, self.value[1:]))


class EpisodeStream(IntEnum):
    """Purposes of an episode's random numbers beside its initial state, which has 0 or the checksum of a name."""

    ACTION_NOISE = 1  # Noise on a demonstrator's actions
    RANDOM_START = 2  # The action that is repeated before a demonstrator takes over
    SPOTS = 3  # Order of the coloured spots of the synthetic domains that are seen


def generator(stream: Stream, *key: int) -> np.random.Generator:
    """Gives the random numbers of one key of a stream: a number below 2³² for each of its parts."""
    assert len(key) == len(stream.parts), f"{stream.name} is keyed by {stream.parts}, found {key}"
    assert all(0 <= part < 1 << 32 for part in key), f"expected numbers of 32 bits, found {key}"
    return np.random.default_rng([stream.value[0], *key])


def episode_generator(seed: int, stream: EpisodeStream) -> np.random.Generator:
    """Gives the random numbers of the episode that has this seed, from :func:`episode_seed`, for one purpose."""
    return np.random.default_rng([seed, int(stream)])


def start_generator(seed: int, name: str = "") -> np.random.Generator:
    """Gives the random numbers of an episode's initial state.

    They depend on a name too, so that equal seeds do not make the initial states of two domains alike.
    """
    return np.random.default_rng([seed, crc32(name.encode())])


def episode_seed(purpose: Purpose, seed: int, domain: str, task: str, index: int) -> int:
    """Seed of episode ``index`` of a task in a domain; seeds rise with the index.

    So the first n demonstrations of a trajectory file, which sorts by seed, stay the same when it grows. ``seed`` is
    that of the run or of the collection.
    """
    entropy = (crc32(purpose.encode()), seed, crc32(domain.encode()), crc32(task.encode()))
    return int(np.random.SeedSequence(entropy).generate_state(1)[0]) * MOST_EPISODES + index
