"""Batches of fixed shape, gathered on a device: a step needs nothing of the host but one vector of indices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from datamodules.batches.dataset import DomainDataset, thinned_rows
from datamodules.batches.images import ImageFile
from datamodules.batches.loader import Cursor, Datasets, Order, PairSource
from datamodules.types import Batch, BatchSpec, PackedTrajectories, Steps

CHUNK = 4
"""Steps whose indices are sent to the device at once: few, so that it has work while they are drawn."""
SHARE = 8
"""Rows of a domain that vary from step to step are filled up to a multiple of the batch's size over this."""


class Layout(NamedTuple):
    """Shape of a batch: what the numbers of a step's index vector are."""

    steps: tuple[tuple[str, int], ...]  # Rows of each domain
    weighted: bool  # Their weights stand behind them
    pairs: tuple[tuple[str, int, int], ...]  # Domain, trajectories P and frames T; rows and mask of each

    @property
    def sizes(self) -> list[int]:
        """Lengths of the parts of an index vector ``(n,)``, in order."""
        rows = [size for _, size in self.steps for _ in range(1 + self.weighted)]
        return [*rows, *(count * time for _, count, time in self.pairs for _ in range(2))]


class Selection(NamedTuple):
    """Numbers by which the batch of one step is gathered."""

    loader: FixedLoader
    layout: Layout
    numbers: Tensor  # ``(n,)`` int64

    def gather(self) -> Batch:
        """The batch: steps ``(B, …)`` and frames ``(P T, …)``, of the tables on the device alone."""
        parts = iter(self.numbers.split(self.layout.sizes))
        steps = {domain: self.loader.steps(domain, parts, self.layout.weighted) for domain, _ in self.layout.steps}
        pairs = {d: self.loader.frames(d, parts, (count, time)) for d, count, time in self.layout.pairs}
        return Batch(steps, pairs)


class FixedLoader(Cursor):
    """Selects batches of a fixed shape from tables that lie on a device.

    Rows are those that a ``Loader`` draws. Those of a domain whose number varies are filled up, with weights of 0, and
    so are trajectories behind their ends. Either loader goes on where the other has stopped.

    Args:
        datasets: Tables, all on one device.
        order: Rows of each step.
        pairs: Trajectory pairs of each step, if any are asked for.
        batch_spec: Contents of the batches.
    """

    def __init__(self, datasets: Datasets, order: Order, pairs: PairSource | None, batch_spec: BatchSpec) -> None:
        super().__init__(datasets, order, pairs, batch_spec)
        self.device = next(iter(datasets.values())).action.device
        self.selected: Selection | None = None  # The newest that was yielded
        if batch_spec.progress:  # computed here, and not in the first step
            assert all(len(dataset.progress) for dataset in datasets.values())
        self.longest = (
            {domain: _longest(dataset, pairs.stride) for domain, dataset in datasets.items()} if pairs else {}
        )

    def __iter__(self) -> Iterator[Selection]:
        """The rest of the epoch that the cursor is in."""
        selections = self._selections(self.epoch, self._next_step)
        for _ in self.places():
            self.selected = next(selections)
            yield self.selected

    def _selections(self, epoch: int, first: int) -> Iterator[Selection]:
        rows = self.order.epoch(epoch)
        sizes, weighted = _sizes(rows)
        for start in range(first, self.limit, CHUNK):
            steps = range(start, min(start + CHUNK, self.limit))
            packed = [self._pack(rows[step], sizes, weighted, epoch, step) for step in steps]
            sent = self._send(np.concatenate([numbers for _, numbers in packed]))
            parts = sent.split([len(numbers) for _, numbers in packed])
            yield from (Selection(self, layout, part) for (layout, _), part in zip(packed, parts, strict=True))

    def steps(self, domain: str, parts: Iterator[Tensor], weighted: bool) -> Steps:
        """The steps at the rows ``(B,)`` that come next in ``parts``, and their weights behind them."""
        spec = self.batch_spec
        found = self.datasets[domain].take(next(parts), spec.next_observation, spec.progress)
        return found._replace(weight=next(parts).float()) if weighted else found

    def frames(self, domain: str, parts: Iterator[Tensor], shape: tuple[int, int]) -> PackedTrajectories:
        """The frames at the rows ``(P T,)`` that come next in ``parts``, and their mask behind them."""
        rows, mask, dataset = next(parts), next(parts), self.datasets[domain]
        frame = torch.arange(len(rows), device=rows.device).view(shape)
        return PackedTrajectories(dataset.observation.take(rows), frame, mask.view(shape).bool(), dataset.action[rows])

    def _pack(
        self, rows: Mapping[str, np.ndarray], sizes: Mapping[str, int], weighted: bool, epoch: int, step: int
    ) -> tuple[Layout, np.ndarray]:
        """Layout and index vector of one step."""
        nothing = np.zeros(0, dtype=np.int64)
        filled = [_filled(rows.get(domain, nothing), size) for domain, size in sizes.items()]
        numbers = [part for pair in filled for part in (pair if weighted else pair[:1])]
        pairs = self._pairs(epoch, step)
        shapes = tuple((domain, found.shape[1], found.shape[2]) for domain, found in pairs.items())
        layout = Layout(tuple(sizes.items()), weighted, shapes)
        return layout, np.concatenate([*numbers, *(found.reshape(-1) for found in pairs.values())])

    def _pairs(self, epoch: int, step: int) -> dict[str, np.ndarray]:
        """Rows and mask ``(2, P, T)`` of the frames of both domains."""
        if self.pairs is None:
            return {}
        domains, episodes, phase = self.pairs.order.step(epoch, step)
        found = {}
        for domain, ids in zip(domains, episodes, strict=True):
            rows, mask = thinned_rows(self.datasets[domain], ids, phase, self.pairs.stride)
            found[domain] = np.zeros((2, len(mask), self.longest[domain]), dtype=np.int64)
            found[domain][:, :, : mask.shape[1]] = rows * mask, mask
        return found

    def _send(self, numbers: np.ndarray) -> Tensor:
        held = torch.from_numpy(numbers)
        held = held.pin_memory() if self.device.type == "cuda" else held
        return held.to(self.device, non_blocking=True)


def is_filled(trajectories: PackedTrajectories) -> bool:
    """Tell whether each of P T places has a frame of its own, in order: none is missing, or all were filled up."""
    return len(trajectories.action) == trajectories.mask.numel()


def by_trajectory(trajectories: PackedTrajectories, values: Tensor) -> Tensor:
    """Values of all frames ``(F, …)`` → ``(P, T, …)``, that of any frame where the mask is False."""
    if is_filled(trajectories):
        return values.view(*trajectories.mask.shape, *values.shape[1:])
    return values[trajectories.frame]


def fits(datasets: Datasets, device: torch.device) -> bool:
    """Tell whether tables may lie on a GPU: images are in memory, and half of the GPU's free memory holds all."""
    images = [images for dataset in datasets.values() for images in dataset.observation.images.values()]
    in_memory = [part for part in images if not isinstance(part, ImageFile)]
    if len(in_memory) < len(images):
        return False
    tables = chain.from_iterable((d.observation.state, d.action, d.task, d.next_row) for d in datasets.values())
    needed = sum(part.nbytes for part in (*tables, *in_memory))
    return needed <= torch.cuda.mem_get_info(device)[0] / 2


def _longest(dataset: DomainDataset, stride: int) -> int:
    """Most frames that are kept of a trajectory."""
    ids = np.arange(len(dataset.episode_task))
    return thinned_rows(dataset, ids, np.zeros(len(ids)), stride)[1].shape[1]


def _sizes(steps: list[dict[str, np.ndarray]]) -> tuple[dict[str, int], bool]:
    """Rows of each domain in every batch of an epoch, and whether some of them only fill it up."""
    domains = list(dict.fromkeys(domain for rows in steps for domain in rows))
    counts = {domain: {len(rows.get(domain, ())) for rows in steps} for domain in domains}
    if all(len(found) == 1 for found in counts.values()):
        return {domain: max(found) for domain, found in counts.items()}, False
    unit = max(1, max(sum(map(len, rows.values())) for rows in steps) // SHARE)
    return {domain: unit * math.ceil(max(found) / unit) for domain, found in counts.items()}, True


def _filled(rows: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows ``(size,)`` and weights, 1 for ``rows`` and 0 for what is put behind them."""
    filled, weights = np.zeros((2, size), dtype=np.int64)
    filled[: len(rows)], weights[: len(rows)] = rows, 1
    return filled, weights
