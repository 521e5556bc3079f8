"""All steps of one domain, as tensors that a batch is gathered from; images may stay in their file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datamodules.images import Images
from datamodules.types import DomainSpec, Observation, Transitions

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
class Table:
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

    def __len__(self) -> int:
        return len(self.action)

    def take(self, rows: Tensor) -> Transitions:
        """The steps at ``rows (B,)`` int64."""
        return Transitions(self.observation.take(rows), self.action[rows], self.task[rows], rows)

    def without_images(self) -> Table:
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

    def rows_of(self, episodes: np.ndarray) -> np.ndarray:
        """Rows of the given trajectories, end to end."""
        lengths = self.offset[episodes + 1] - self.offset[episodes]
        starts = np.repeat(self.offset[episodes] - np.cumsum(lengths) + lengths, lengths)
        rows: np.ndarray = starts + np.arange(lengths.sum())
        return rows


def build_table(
    spec: DomainSpec,
    state: np.ndarray,
    image: Images | None,
    actions: np.ndarray,
    offset: np.ndarray,
    episode_task: np.ndarray,
) -> Table:
    """Wrap the arrays of a trajectory file; the tensors share their memory."""
    observation = StoredObservation(torch.from_numpy(state), image)
    task = torch.from_numpy(np.repeat(episode_task.astype(np.int64), np.diff(offset)))
    return Table(spec, observation, torch.from_numpy(actions), task, offset, episode_task.astype(np.int64))
