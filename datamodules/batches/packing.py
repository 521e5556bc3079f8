"""Thinned-out trajectories, laid end to end: what temporal cycle-consistency compares."""

from __future__ import annotations

import numpy as np
import torch

from datamodules.batches.dataset import DomainDataset
from datamodules.types import PackedTrajectories


def thin_out(dataset: DomainDataset, episodes: np.ndarray, phase: np.ndarray, stride: int) -> PackedTrajectories:
    """Keep one of every ``stride`` frames of each trajectory, two frames at the least.

    Args:
        dataset: The domain's steps.
        episodes: ``(P,)`` trajectory ids.
        phase: ``(P,)`` in [0, 1), where in the first stride to begin.
        stride: Distance of the kept frames, in steps; shortened for trajectories that are not longer.
    """
    start, length = dataset.offset[episodes], np.diff(dataset.offset)[episodes]
    stride_of = np.minimum(stride, np.maximum(1, length - 1))
    first = (phase * np.minimum(stride_of, np.maximum(1, length - stride_of))).astype(np.int64)
    frames = (length - 1 - first) // stride_of + 1
    t = np.arange(frames.max())
    mask = t < frames[:, None]
    rows = (start + first)[:, None] + t * stride_of[:, None]
    index = np.where(mask, mask.cumsum().reshape(mask.shape) - 1, 0)
    kept = torch.from_numpy(rows[mask])
    return PackedTrajectories(
        dataset.observation.take(kept), torch.from_numpy(index), torch.from_numpy(mask), dataset.action[kept]
    )
