"""All steps of one domain, as tensors that a batch is gathered from; images may stay in their file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datamodules.batches.images import Images
from datamodules.types import Course, DomainSpec, Observation, Steps

MOST_IMAGE_BYTES = 16 * 2**20
"""Of images that are looked at together, outside of training."""


@dataclass(frozen=True)
class StoredObservation:
    """What the policy may see of all N steps."""

    state: Tensor
    """``(N, O)`` float32."""
    image: Images | None
    """``(N, H, W, C)`` uint8, in memory or not; None without a camera or a use for it."""

    def take(self, rows: Any) -> Observation[Tensor]:
        """The observations at ``rows``, an index array or tensor, or a slice."""
        return Observation(self.state[rows], None if self.image is None else self.image[rows])


@dataclass(frozen=True)
class DomainDataset:
    """The trajectories of one domain, end to end; N steps in E trajectories."""

    spec: DomainSpec
    observation: StoredObservation
    """State ``(N, O)`` float32, image ``(N, H, W, C)`` uint8."""
    action: Tensor
    """``(N, A)`` float32."""
    task: Tensor
    """``(N,)`` int64."""
    offset: np.ndarray
    """``(E + 1,)`` int64: trajectory e is rows ``offset[e]`` to ``offset[e + 1]``."""
    episode_task: np.ndarray
    """``(E,)`` int64."""
    episode_seed: np.ndarray
    """``(E,)`` int64: seed of the initial state."""

    def __len__(self) -> int:
        return len(self.action)

    def take(self, rows: Tensor, course: bool = False) -> Steps:
        """The steps at ``rows (B,)`` int64, and if asked for where they stand in their trajectories."""
        seen, action, task = self.observation.take(rows), self.action[rows], self.task[rows]
        return Steps(seen, action, task, rows, self.course(rows) if course else None)

    def course(self, rows: Tensor) -> Course:
        """What comes after the steps at ``rows (B,)`` int64, and how far they are."""
        last = self.last_row[rows]
        ends = rows == last
        progress = 1 - (last - rows) / (last - self.first_row[rows]).clamp(min=1)
        return Course(self.observation.take(rows + ~ends), ends, progress)

    @cached_property
    def first_row(self) -> Tensor:
        """``(N,)`` int64: first row of each step's trajectory."""
        return torch.from_numpy(np.repeat(self.offset[:-1], np.diff(self.offset)))

    @cached_property
    def last_row(self) -> Tensor:
        """``(N,)`` int64: last row of each step's trajectory."""
        return torch.from_numpy(np.repeat(self.offset[1:] - 1, np.diff(self.offset)))

    def without_images(self) -> DomainDataset:
        """The same for those who don't look: nothing is read from the file for them."""
        return replace(self, observation=replace(self.observation, image=None))

    def pieces(self) -> Iterator[Tensor]:
        """All values, one after the other, in pieces that fit into memory."""
        yield from (self.observation.state, self.action, self.task)
        if self.observation.image is not None:
            step = self.rows_at_a_time(len(self))
            yield from (self.observation.image[i : i + step] for i in range(0, len(self), step))

    def rows_at_a_time(self, most: int) -> int:
        """``most``, or fewer steps if so many images would take up too much memory."""
        image = self.spec.image_key
        return most if image is None else max(1, min(most, MOST_IMAGE_BYTES // math.prod(image.shape)))

    def episodes_of(self, tasks: np.ndarray) -> np.ndarray:
        """Ids of the trajectories of ``tasks``, in order."""
        return np.flatnonzero(np.isin(self.episode_task, tasks))

    def episode_of(self, rows: np.ndarray) -> np.ndarray:
        """Trajectory id of each row."""
        return np.searchsorted(self.offset, rows, side="right") - 1

    def rows_of(self, episodes: np.ndarray) -> np.ndarray:
        """Rows of the given trajectories, end to end."""
        lengths = self.offset[episodes + 1] - self.offset[episodes]
        starts = np.repeat(self.offset[episodes] - np.cumsum(lengths) + lengths, lengths)
        rows: np.ndarray = starts + np.arange(lengths.sum())
        return rows


def build_dataset(
    spec: DomainSpec,
    state: np.ndarray,
    image: Images | None,
    actions: np.ndarray,
    offset: np.ndarray,
    episode_task: np.ndarray,
    episode_seed: np.ndarray,
) -> DomainDataset:
    """Wrap the arrays of a trajectory file; the tensors share their memory."""
    observation = StoredObservation(torch.from_numpy(state), image)
    task = torch.from_numpy(np.repeat(episode_task.astype(np.int64), np.diff(offset)))
    return DomainDataset(
        spec, observation, torch.from_numpy(actions), task, offset, episode_task.astype(np.int64), episode_seed
    )
