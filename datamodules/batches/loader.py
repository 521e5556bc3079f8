"""An iterable of batches with a cursor: it can be stopped after any batch and goes on with the next one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol, TypeAlias

import numpy as np
import torch

from datamodules.batches.dataset import DomainDataset, thin_out
from datamodules.batches.orders import PairOrder
from datamodules.types import Batch, BatchSpec, PackedTrajectories, Steps

Datasets: TypeAlias = Mapping[str, DomainDataset]
PLAIN = BatchSpec()


def _take(dataset: DomainDataset, rows: np.ndarray, batch_spec: BatchSpec) -> Steps:
    return dataset.take(torch.from_numpy(rows), batch_spec.next_observation, batch_spec.progress)


class Order(Protocol):
    """Rows of each step of an epoch."""

    steps: int

    def epoch(self, epoch: int) -> list[dict[str, np.ndarray]]:
        """Rows ``(B,)`` by domain for every step."""


class PairSource:
    """Trajectory pairs of a step, thinned out: one of ``stride`` frames is kept."""

    def __init__(self, datasets: Datasets, order: PairOrder, stride: int) -> None:
        self.datasets, self.order, self.stride = datasets, order, stride

    def __call__(self, epoch: int, step: int) -> dict[str, PackedTrajectories]:
        """The two domains' trajectories for one step, frames ``(F, …)`` of each."""
        domains, episodes, phase = self.order.step(epoch, step)
        parts = zip(domains, episodes, strict=True)
        return {domain: thin_out(self.datasets[domain], ids, phase, self.stride) for domain, ids in parts}


class Cursor:
    """A place in the steps of all epochs, which always points at the next batch to yield.

    So ``state_dict`` taken while a batch is being trained on says where to go on after it. Without a source of pairs,
    batches hold steps alone.
    """

    def __init__(
        self, datasets: Datasets, order: Order, pairs: PairSource | None = None, batch_spec: BatchSpec = PLAIN
    ) -> None:
        self.datasets, self.order, self.pairs, self.batch_spec = datasets, order, pairs, batch_spec
        self._next_epoch, self._next_step = 0, 0
        self.limit, self.repeats = order.steps, False

    def cut(self, limit: int, repeats: bool) -> None:
        """End each epoch after at most ``limit`` batches, and give those of the first epoch anew if it ``repeats``."""
        self.limit, self.repeats = min(limit, self.order.steps), repeats

    def __len__(self) -> int:
        return self.order.steps

    @property
    def epoch(self) -> int:
        """The epoch whose batches come next."""
        return 0 if self.repeats else self._next_epoch

    def places(self) -> Iterator[int]:
        """Steps that are left of the epoch that the cursor is in; it moves on before each."""
        now = self._next_epoch
        for step in range(self._next_step, self.limit):
            self._next_epoch, self._next_step = (now + 1, 0) if step + 1 == self.limit else (now, step + 1)
            yield step

    def state_dict(self) -> dict[str, int]:
        """Epoch and step of the next batch."""
        return {"epoch": self._next_epoch, "step": self._next_step}

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Go on where ``state`` was taken."""
        self._next_epoch, self._next_step = state["epoch"], state["step"]


class Loader(Cursor):
    """Gathers each step's batch from datasets in memory."""

    def __iter__(self) -> Iterator[Batch]:
        """The rest of the epoch that the cursor is in."""
        epoch = self.epoch
        rows = self.order.epoch(epoch)
        for step in self.places():
            steps = {domain: _take(self.datasets[domain], r, self.batch_spec) for domain, r in rows[step].items()}
            yield Batch(steps, self.pairs(epoch, step) if self.pairs else {})


class FixedBatches:
    """Held-out steps of rows ``(n,)`` by domain, in order, a domain after the other; the same batches at every pass."""

    def __init__(
        self, datasets: Datasets, rows: Mapping[str, np.ndarray], batch_size: int, batch_spec: BatchSpec = PLAIN
    ) -> None:
        self.datasets, self.batch_spec = datasets, batch_spec
        self.chunks = [(d, r[i : i + batch_size]) for d, r in rows.items() for i in range(0, len(r), batch_size)]

    def __len__(self) -> int:
        return len(self.chunks)

    def __iter__(self) -> Iterator[Batch]:
        for domain, rows in self.chunks:
            yield Batch({domain: _take(self.datasets[domain], rows, self.batch_spec)}, {})


class FixedPairs:
    """Each trajectory of a domain once, whole, beside one of its task in another domain; the same at every pass.

    Of the trajectory ids ``episodes[domain][task] (n,)`` in two domains, those of the second come once each; those of
    the first take turns beside them. Tasks that the first lacks are left out. A batch holds ``count`` pairs.
    """

    def __init__(self, datasets: Datasets, episodes: Mapping[str, Mapping[int, np.ndarray]], count: int) -> None:
        self.datasets, self.domains = datasets, tuple(episodes)
        first, second = episodes.values()
        turns = [np.resize(first[task], len(ids)) for task, ids in second.items() if task in first]
        rows = [second[task] for task in second if task in first]
        pairs = np.array([np.concatenate(part) if part else [] for part in (turns, rows)], dtype=np.int64)
        self.chunks = [pairs[:, i : i + count] for i in range(0, pairs.shape[1], count)]

    def __len__(self) -> int:
        return len(self.chunks)

    def __iter__(self) -> Iterator[Batch]:
        for chunk in self.chunks:
            phase = np.zeros(chunk.shape[1])
            parts = zip(self.domains, chunk, strict=True)
            yield Batch({}, {domain: thin_out(self.datasets[domain], ids, phase, stride=1) for domain, ids in parts})
