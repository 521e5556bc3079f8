"""Threads that torch computes on."""

from __future__ import annotations

import torch

from plp_lightning.methods.contextual.denormals import without_denormals

LEAST_SHARE = 2**15
"""Elements that torch gives to a thread at least (``at::internal::GRAIN_SIZE``)."""


def use_threads(count: int) -> None:
    """Compute on ``count`` threads: this one and others, which take floats below 1e-38 for 0 from the first on.

    This thread may do so for a while (:mod:`plp_lightning.methods.contextual.denormals`), but can't ask others to, for
    which all would wait. Threads begin with the setting of the one that needs them first.
    """
    torch.set_num_threads(count)
    with without_denormals():
        torch.ones(count * LEAST_SHARE).add_(1)
