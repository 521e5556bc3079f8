"""All steps of one domain in memory, as tensors that a batch is gathered from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from datamodules.types import DomainSpec, Observation, Transitions


@dataclass(frozen=True)
class Table:
    """The trajectories of one domain, end to end; N steps in E trajectories."""

    spec: DomainSpec
    observation: Observation[Tensor]
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
    image: np.ndarray | None,
    actions: np.ndarray,
    offset: np.ndarray,
    episode_task: np.ndarray,
) -> Table:
    """Wrap the arrays of a trajectory file; the tensors share their memory."""
    observation = Observation(torch.from_numpy(state), None if image is None else torch.from_numpy(image))
    task = torch.from_numpy(np.repeat(episode_task.astype(np.int64), np.diff(offset)))
    return Table(spec, observation, torch.from_numpy(actions), task, offset, episode_task.astype(np.int64))
