"""All steps of one domain, as tensors that a batch is gathered from; images may stay in their file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from datamodules.batches.images import ImageFile, Images
from datamodules.errors import TrajectoryFileError
from datamodules.types import NO_IMAGES, DomainSpec, Observation, PackedTrajectories, Steps

MOST_IMAGE_BYTES = 16 * 2**20  # Of images that are looked at together, outside of training


@dataclass(frozen=True)
class StoredObservation:
    """Observations before all N steps, then the L last observations that are known."""

    state: Tensor  # ``(N + L, O)`` float32
    images: Mapping[str, Images]
    """By camera ``(N + L, H, W, C)`` uint8, in memory or not; empty without a camera or a use for it."""

    def __len__(self) -> int:
        return len(self.state)

    def take(self, rows: Any) -> Observation[Tensor]:
        """The observations ``(B, …)`` at ``rows``, an index array or tensor ``(B,)``, or a slice."""
        if not self.images:
            return Observation(self.state[rows])
        return Observation(self.state[rows], {name: image[rows] for name, image in self.images.items()})

    def to(self, device: torch.device) -> StoredObservation:
        """The same on a device, images ``(N + L, H, W, C)`` too, unless they stay in their file."""
        images = {name: x if isinstance(x, ImageFile) else x.to(device) for name, x in self.images.items()}
        return StoredObservation(self.state.to(device), images)


@dataclass(frozen=True)
class DomainDataset:
    """The trajectories of one domain, end to end; N steps in E trajectories.

    Last observations stand behind those of the steps, so that a step's row is the same whether they are known or not.
    """

    spec: DomainSpec
    observation: StoredObservation  # State ``(N + L, O)`` float32, images ``(N + L, H, W, C)`` uint8
    action: Tensor  # ``(N, A)`` float32
    task: Tensor  # ``(N,)`` int64
    offset: np.ndarray  # ``(E + 1,)`` int64: trajectory e is rows ``offset[e]`` to ``offset[e + 1]``
    episode_task: np.ndarray  # ``(E,)`` int64
    episode_seed: np.ndarray  # ``(E,)`` int64: seed of the initial state
    next_row: Tensor  # ``(N,)`` int64: row of the observation after each step; -1 if nobody knows it

    def __len__(self) -> int:
        return len(self.action)

    def take(self, rows: Tensor, next_observation: bool = False, progress: bool = False) -> Steps:
        """The steps at rows ``(B,)`` int64, and if asked for what is seen next and how far their trajectories are.

        Every one of the steps has to have a :attr:`next_row` if what is seen next is asked for.
        """
        seen, action, task = self.observation.take(rows), self.action[rows], self.task[rows]
        seen_next = self.observation.take(self._known_next(rows)) if next_observation else None
        return Steps(seen, action, task, rows, seen_next, self.progress[rows] if progress else None)

    def _known_next(self, rows: Tensor) -> Tensor:
        following = self.next_row[rows]
        on_device = following.device.type != "cpu"  # where a look would wait for all that was asked for before
        assert on_device or (following >= 0).all(), "what is seen next is known of every step that is drawn for it"
        return following

    @cached_property
    def progress(self) -> Tensor:
        """``(N,)`` float32: share of the trajectory that lies behind, 0 at its first step and 1 at its last."""
        length = np.diff(self.offset)
        to_go = torch.from_numpy(np.repeat(self.offset[1:] - 1, length)) - torch.arange(len(self))
        behind = 1 - to_go / torch.from_numpy(np.repeat(length - 1, length)).clamp(min=1)
        return behind.to(self.action.device)

    def without_images(self) -> DomainDataset:
        """The same states ``(N + L, O)`` without images: nothing is read from the file for them."""
        return replace(self, observation=replace(self.observation, images=NO_IMAGES))

    def to(self, device: torch.device) -> DomainDataset:
        """The same with its tensors ``(N, …)`` on a device, to gather batches there."""
        action, task, next_row = (part.to(device) for part in (self.action, self.task, self.next_row))
        return replace(self, observation=self.observation.to(device), action=action, task=task, next_row=next_row)

    def pieces(self) -> Iterator[Tensor]:
        """All values, one after the other, in pieces ``(n, …)`` that fit into memory."""
        yield from (self.observation.state, self.action, self.task)
        if len(self.observation) > len(self):  # or else data without last observations would seem to have changed
            yield self.next_row
        for image in self.observation.images.values():
            step = self.rows_at_a_time(len(self.observation))
            yield from (image[i : i + step] for i in range(0, len(self.observation), step))

    def rows_at_a_time(self, most: int) -> int:
        """Give ``most``, or fewer steps if so many images ``(H, W, C)`` would take up too much memory."""
        size = sum(math.prod(key.shape) for key in self.spec.image_keys)
        return max(1, min(most, MOST_IMAGE_BYTES // size)) if size else most

    def episodes_of(self, tasks: np.ndarray) -> np.ndarray:
        """Ids ``(n,)`` of the trajectories of tasks ``(K,)``, in order."""
        return np.flatnonzero(np.isin(self.episode_task, tasks))

    def episode_of(self, rows: np.ndarray) -> np.ndarray:
        """Trajectory ids ``(B,)`` of rows ``(B,)``."""
        return np.searchsorted(self.offset, rows, side="right") - 1

    def rows_of(self, episodes: np.ndarray) -> np.ndarray:
        """Rows ``(n,)`` of the trajectories ``(P,)``, end to end."""
        lengths = self.offset[episodes + 1] - self.offset[episodes]
        starts = np.repeat(self.offset[episodes] - np.cumsum(lengths) + lengths, lengths)
        rows: np.ndarray = starts + np.arange(lengths.sum())
        return rows


def build_dataset(
    spec: DomainSpec,
    state: np.ndarray,
    images: Mapping[str, Images],
    actions: np.ndarray,
    offset: np.ndarray,
    episode_task: np.ndarray,
    episode_seed: np.ndarray,
    last: np.ndarray,
) -> DomainDataset:
    """Wrap the arrays of a trajectory file, shaped as in :class:`DomainDataset`; the tensors share their memory.

    last ``(E,)`` are the rows of the episodes' last observations in state and images, -1 where nobody knows them.
    """
    tasks, next_row = episode_task.astype(np.int64), np.arange(1, len(actions) + 1)
    next_row[offset[1:] - 1] = last
    action, task, following = map(torch.from_numpy, (actions, np.repeat(tasks, np.diff(offset)), next_row))
    observation = StoredObservation(torch.from_numpy(state), images)
    return DomainDataset(spec, observation, action, task, offset, tasks, episode_seed, following)


def check_values(path: Path, domain: str, dataset: DomainDataset) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, values that nothing can be learned from.

    These are states ``(N + L, O)`` and actions ``(N, A)`` that are not finite, and actions outside [-1, 1].
    """
    state, action = dataset.observation.state, dataset.action
    faults = {
        "observations hold values that are not finite": not torch.isfinite(state).all(),
        "actions hold values that are not finite": not torch.isfinite(action).all(),
        "actions lie outside [-1, 1]": bool((action.abs() > 1).any()),
    }
    for fault, found in faults.items():
        if found:
            raise TrajectoryFileError(
                f"{path}: in domain {domain!r} {fault}; expected what a writer accepts: see plp data validate {path}"
            )


def thin_out(dataset: DomainDataset, episodes: np.ndarray, phase: np.ndarray, stride: int) -> PackedTrajectories:
    """Keep one of every ``stride`` frames of each trajectory, as :func:`thinned_rows` does, and lay them end to end."""
    rows, mask = thinned_rows(dataset, episodes, phase, stride)
    # Frames are drawn and encoded end to end, without padding; index then tells where (p, t) stands among them.
    index = np.where(mask, mask.cumsum().reshape(mask.shape) - 1, 0)
    kept = torch.from_numpy(rows[mask])
    return PackedTrajectories(
        dataset.observation.take(kept), torch.from_numpy(index), torch.from_numpy(mask), dataset.action[kept]
    )


def thinned_rows(
    dataset: DomainDataset, episodes: np.ndarray, phase: np.ndarray, stride: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows ``(P, T)`` of one of every ``stride`` frames of each trajectory, two frames at the least, and their mask.

    Args:
        dataset: The domain's steps.
        episodes: Trajectory ids ``(P,)``.
        phase: Places ``(P,)`` in [0, 1) to begin at in the first stride.
        stride: Distance of the kept frames, in steps; shortened for trajectories that are not longer.
    """
    start, length = dataset.offset[episodes], np.diff(dataset.offset)[episodes]
    # A trajectory of two steps or more keeps two frames whatever the stride: with one frame there is no cycle to close.
    stride_of = np.minimum(stride, np.maximum(1, length - 1))
    # It begins within its first stride, and not so late that the second frame would lie behind the end.
    first = (phase * np.minimum(stride_of, np.maximum(1, length - stride_of))).astype(np.int64)
    frames = (length - 1 - first) // stride_of + 1
    t = np.arange(frames.max())
    mask = t < frames[:, None]
    return (start + first)[:, None] + t * stride_of[:, None], mask
