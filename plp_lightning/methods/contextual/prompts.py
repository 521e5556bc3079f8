"""The demonstrations that a contextual policy is shown, one for each task; a checkpoint carries them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from datamodules.batches.dataset import DomainDataset
from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation, PackedTrajectories
from plp_lightning.methods.contextual.frames import lay_out


class Prompts(nn.Module):
    """One demonstration of the source domain for each task, raw, in buffers; none until :meth:`choose`.

    Args:
        spec: The source domain.
        tasks: Names of all tasks.
        images: Keep images too.
    """

    state: Tensor
    action: Tensor
    offset: Tensor

    def __init__(self, spec: DomainSpec, tasks: Sequence[str], images: bool) -> None:
        super().__init__()
        self.domain, self.tasks = spec.name, tuple(tasks)
        cameras = spec.image_keys if images else ()
        self.cameras = {key.name: f"image_{i}" if i else "image" for i, key in enumerate(cameras)}
        self.register_buffer("state", torch.zeros(0, spec.state_size))
        self.register_buffer("action", torch.zeros(0, spec.action_size))
        for key, name in zip(cameras, self.cameras.values(), strict=True):
            self.register_buffer(name, torch.zeros(0, *key.shape, dtype=torch.uint8))
        if not cameras:  # as checkpoints always had it
            self.register_buffer("image", torch.zeros(0, dtype=torch.uint8))
        self.register_buffer("offset", torch.zeros(len(tasks) + 1, dtype=torch.int64))
        self.register_load_state_dict_pre_hook(_make_room)  # type: ignore[no-untyped-call]

    def choose(self, dataset: DomainDataset, episodes: Mapping[int, int]) -> None:
        """Takes a trajectory ``(T, O)`` of the source domain by task index; tasks left out have none to show."""
        order, device = sorted(episodes), self.offset.device
        chosen = np.array([episodes[task] for task in order])
        rows = torch.from_numpy(dataset.rows_of(chosen))
        seen = dataset.observation.take(rows)
        self.state, self.action = seen.state.to(device), dataset.action[rows].to(device)
        for camera, name in self.cameras.items():
            setattr(self, name, seen.images[camera].to(device))
        lengths = np.zeros(len(self.tasks), dtype=np.int64)
        lengths[order] = np.diff(dataset.offset)[chosen]
        self.offset = torch.from_numpy(np.concatenate([[0], lengths.cumsum()])).to(device)

    def of(self, tasks: Tensor) -> PackedTrajectories:
        """Gives the demonstrations ``(P, T)`` of ``tasks (P,)`` int64.

        Raises:
            UserError: If there is none of a task.
        """
        start, length = self.offset[tasks], self.offset[tasks + 1] - self.offset[tasks]
        if bool((length == 0).any()):
            raise UserError(
                f"found no demonstration of task {self.tasks[int(tasks[length == 0][0])]!r} in domain "
                f"{self.domain!r} to show to the policy; expected a trained policy and a task it has one of: "
                "train with demonstrations of the task"
            )
        step = torch.arange(int(length.max()), device=tasks.device)
        mask = step < length[:, None]
        rows = (start[:, None] + step)[mask]
        images = {camera: self.get_buffer(name)[rows] for camera, name in self.cameras.items()}
        return PackedTrajectories(Observation(self.state[rows], images), lay_out(mask), mask, self.action[rows])


def _make_room(prompts: nn.Module, state: dict[str, Any], prefix: str, *rest: object) -> None:
    """Before a checkpoint is loaded: how long the demonstrations are, only the checkpoint knows."""
    for name, known in [*prompts.named_buffers(recurse=False)]:
        loaded = state.get(prefix + name) if name != "offset" else None
        if loaded is not None and loaded.shape[1:] == known.shape[1:]:
            setattr(prompts, name, known.new_zeros(loaded.shape))
