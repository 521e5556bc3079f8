"""Gradients on a processor without the smallest floats."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import Variable


def without_denormals(loss: Tensor) -> Tensor:
    """The same loss, whose gradients on a processor are found with floats below 1e-38 taken for 0.

    Attention's weights of frames that are hardly looked at are such floats, with which a processor takes six times as
    long. Nothing else counts so: simulators keep them.
    """
    if loss.requires_grad and not loss.is_cuda:
        loss.register_hook(_begin)
    return loss


def _begin(_: Tensor) -> None:
    torch.set_flush_denormal(True)
    Variable._execution_engine.queue_callback(_end)


def _end() -> None:
    torch.set_flush_denormal(False)
