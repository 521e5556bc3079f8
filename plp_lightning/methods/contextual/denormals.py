"""Gradients on a processor without the smallest floats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

SMALL = 1e-39
"""A denormal float32."""


@contextmanager
def without_denormals() -> Iterator[None]:
    """Count with floats below 1e-38 taken for 0 in the block, on a processor and in this thread.

    Attention's weights of frames that are hardly looked at are such floats, with which a processor takes six times as
    long to find gradients. Nothing else counts so: simulators keep them. Afterwards this thread counts as before.
    """
    before = are_zero()
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(before)


def are_zero() -> bool:
    """Tell whether this thread takes the smallest floats for 0, which torch says nowhere."""
    return bool((torch.tensor(SMALL) * 1).item() == 0)
