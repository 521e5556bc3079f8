"""The device that a policy computes on, in training and afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Trainer
from torch import nn

from plp_lightning.runs.trainer import quiet_lightning


def resolved_device(settings: Mapping[str, Any]) -> torch.device:
    """Give the device that the Trainer's ``accelerator`` comes to, or the processor if it isn't here.

    One device is enough to act, however many a run was trained on.
    A run of another machine can be looked at without the device that it was trained on.
    """
    quiet_lightning()
    silent: dict[str, Any] = {"logger": False, "enable_checkpointing": False, "enable_progress_bar": False}
    try:
        return Trainer(accelerator=settings.get("accelerator") or "auto", devices=1, **silent).strategy.root_device
    except (MisconfigurationException, ValueError, ImportError):
        return torch.device("cpu")


def device_name(device: torch.device) -> str:
    """The name of a GPU; the kind of any other device."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


@contextmanager
def on_device(module: nn.Module, device: torch.device) -> Iterator[None]:
    """Have a module on a device for the block, and on the processor afterwards."""
    module.to(device)
    try:
        yield
    finally:
        module.cpu()
