"""The order of training data: every draw is a pure function of (seed, epoch), so any step can be found again."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from datamodules.streams import Stream, generator

Rows: TypeAlias = Mapping[str, np.ndarray]
"""Rows ``(N,)`` to draw from, by domain."""


def shuffled(rows: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw ``count`` of rows ``(N,)``, each once before any comes again."""
    rounds = max(1, -(-count // len(rows)))
    drawn: np.ndarray = np.concatenate([rng.permutation(rows) for _ in range(rounds)])[:count]
    return drawn


class AlignmentOrder:
    """Steps of the alignment phase: equal shares of every domain, as many samples an epoch as all have together.

    So a small domain's rows come more than once in an epoch, a large one's not all; the paper says only that
    batches are drawn from all demonstrations.

    Args:
        rows: Rows ``(N,)`` to draw from, by domain.
        batch_size: Steps in a batch, all domains together.
        seed: Seed of the run.
        least_steps: Least steps in an epoch.
    """

    def __init__(self, rows: Rows, batch_size: int, seed: int, least_steps: int = 1) -> None:
        self.rows, self.seed = rows, seed
        self.share = max(1, batch_size // len(rows))
        self.steps = max(-(-sum(len(r) for r in rows.values()) // (self.share * len(rows))), least_steps)

    def epoch(self, epoch: int) -> list[dict[str, np.ndarray]]:
        """Rows ``(share,)`` by domain, for each step of the epoch."""
        drawn = self._drawn(epoch)
        return [{domain: rows[step] for domain, rows in drawn.items()} for step in range(self.steps)]

    def _drawn(self, epoch: int) -> dict[str, np.ndarray]:
        """Rows ``(steps, share)`` by domain."""
        drawn = {}
        for i, (domain, rows) in enumerate(self.rows.items()):
            rng = generator(Stream.ALIGNMENT_ROWS, self.seed, epoch, i)
            drawn[domain] = shuffled(rows, self.steps * self.share, rng).reshape(self.steps, self.share)
        return drawn


class TaskwiseOrder(AlignmentOrder):
    """Alignment steps whose batches hold the same few tasks in every domain, so that losses compare like with like.

    A task comes as often as its share of the demonstrations, at most once in a batch.

    Args:
        rows: Rows ``(N,)`` to draw from, by domain.
        tasks: Tasks ``(N,)`` of these rows, by domain. In a domain without a task's rows any row may take their place.
        tasks_per_batch: So many tasks in a batch, or ``half`` of all, rounded up; all of them if there are fewer.
        batch_size: Steps in a batch, all domains together.
        seed: Seed of the run.
        least_steps: Least steps in an epoch.
    """

    def __init__(
        self,
        rows: Rows,
        tasks: Mapping[str, np.ndarray],
        tasks_per_batch: int | Literal["half"],
        batch_size: int,
        seed: int,
        least_steps: int = 1,
    ) -> None:
        super().__init__(rows, batch_size, seed, least_steps)
        self.known = np.unique(np.concatenate([*tasks.values()]))
        wanted = -(-len(self.known) // 2) if tasks_per_batch == "half" else tasks_per_batch
        self.tasks_per_batch = min(wanted, len(self.known))
        shares = [np.mean(tasks[domain][:, None] == self.known, axis=0) for domain in rows]
        self.logits = np.log(np.mean(shares, axis=0))
        self.rows_of = {
            d: [r[tasks[d] == task] if task in tasks[d] else r for task in self.known] for d, r in rows.items()
        }

    def _drawn(self, epoch: int) -> dict[str, np.ndarray]:
        slots = self._slots(generator(Stream.BATCH_TASKS, self.seed, epoch))
        return {
            domain: self._fill(slots, pools, generator(Stream.ALIGNMENT_ROWS, self.seed, epoch, i))
            for i, (domain, pools) in enumerate(self.rows_of.items())
        }

    def _slots(self, rng: np.random.Generator) -> np.ndarray:
        """``(steps, share)``: position among the known tasks of every sample, alike in all domains."""
        # The largest of logits plus Gumbel noise are a weighted draw without replacement.
        keys = self.logits + rng.gumbel(size=(self.steps, len(self.known)))
        chosen = np.argsort(-keys, axis=1)[:, : self.tasks_per_batch]
        return chosen[:, np.arange(self.share) % self.tasks_per_batch]

    def _fill(self, slots: np.ndarray, pools: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
        drawn = np.empty(slots.shape, dtype=np.int64)
        for task, pool in enumerate(pools):
            here = slots == task
            drawn[here] = shuffled(pool, int(here.sum()), rng)
        return drawn


class NoSteps:
    """Epochs of so many steps, for phases that train on trajectory pairs alone."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def epoch(self, epoch: int) -> list[dict[str, np.ndarray]]:
        """Give no rows ``(0,)`` in any domain, ``steps`` times."""
        return [{} for _ in range(self.steps)]


class MixOrder:
    """Steps of the adaptation phase: all of the target task's data, and alignment data anew each epoch.

    Args:
        target: Rows ``(N,)`` of the new task's demonstrations, by domain.
        pool: Rows ``(M,)`` of the alignment data, by domain.
        ratio: Alignment steps for each target step ("mix": the paper's 2× or 1×).
        batch_size: Steps in a batch; the last batch of an epoch may be smaller.
        seed: Seed of the run.
        least_steps: Least steps in an epoch; the target task's data come as many times as that takes.
    """

    def __init__(
        self, target: Rows, pool: Rows, ratio: float, batch_size: int, seed: int, least_steps: int = 1
    ) -> None:
        self.domains = list(dict.fromkeys([*target, *pool]))
        once, self.pool = self._flat(target), self._flat(pool)
        mixed = round(ratio * len(once)) if len(self.pool) else 0
        times = max(1, -(-least_steps * batch_size // max(1, len(once) + mixed)))
        self.target = np.tile(once, (times, 1))
        self.mixed = round(ratio * len(self.target)) if len(self.pool) else 0
        self.batch_size, self.seed = batch_size, seed
        self.steps = -(-(len(self.target) + self.mixed) // batch_size)

    def _flat(self, rows: Rows) -> np.ndarray:
        """``(N, 2)``: domain index and row."""
        parts = [np.stack([np.full_like(r, self.domains.index(d)), r], axis=1) for d, r in rows.items()]
        return np.concatenate(parts) if parts else np.zeros((0, 2), dtype=np.int64)

    def epoch(self, epoch: int) -> list[dict[str, np.ndarray]]:
        """Rows ``(B,)`` by domain, for each step of the epoch; a domain without rows is left out."""
        rng = generator(Stream.MIX, self.seed, epoch)
        mixed = [self.pool[shuffled(np.arange(len(self.pool)), self.mixed, rng)]] if self.mixed else []
        drawn = rng.permutation(np.concatenate([self.target, *mixed]))
        batches = [drawn[i : i + self.batch_size] for i in range(0, len(drawn), self.batch_size)]
        return [{self.domains[i]: batch[batch[:, 0] == i, 1] for i in np.unique(batch[:, 0])} for batch in batches]


class PairDraw(NamedTuple):
    """Trajectories to compare in one step: row p of both domains demonstrates the same task."""

    domains: tuple[str, str]
    episodes: np.ndarray  # ``(2, P)``: trajectory ids in the first and the second domain
    phase: np.ndarray
    """``(P,)`` in [0, 1): where in the first stride both begin, so that every frame gets its turn beside its like."""


class PairOrder:
    """Trajectory pairs for temporal cycle-consistency, a batch for each training step.

    Args:
        episodes: Trajectory ids ``episodes[domain][task] (n,)``; tasks lacking in a domain are not drawn.
        count: Pairs in a batch, P.
        seed: Seed of the run.
    """

    def __init__(self, episodes: Mapping[str, Mapping[int, np.ndarray]], count: int, seed: int) -> None:
        self.episodes, self.count, self.seed = episodes, count, seed
        self.domain_pairs = list(itertools.combinations(episodes, 2))

    def step(self, epoch: int, step: int) -> PairDraw:
        """Pairs ``(2, P)`` of one step; with more than two domains the pairs of domains take turns."""
        first, second = self.domain_pairs[step % len(self.domain_pairs)]
        rng = generator(Stream.PAIRS, self.seed, epoch, step)
        common = sorted(set(self.episodes[first]) & set(self.episodes[second]))
        tasks = rng.choice(common, self.count)
        drawn = np.stack([self._pick(domain, tasks, rng) for domain in (first, second)])
        return PairDraw((first, second), drawn, rng.random(self.count))

    def _pick(self, domain: str, tasks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        pools = (self.episodes[domain][task] for task in tasks)
        return np.array([pool[int(u * len(pool))] for pool, u in zip(pools, rng.random(len(tasks)), strict=True)])
