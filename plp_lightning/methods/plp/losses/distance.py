"""Euclidean distances out of matrix products, in float32 and without infinite gradients."""

from __future__ import annotations

import torch
from torch import Tensor


def full_precision(tensor: Tensor) -> Tensor:
    """``tensor (...)`` in float32 at least: half-precision latents are compared in single precision."""
    return tensor.to(torch.promote_types(tensor.dtype, torch.float32))


def inverse_distance(squared: Tensor, norms: Tensor) -> Tensor:
    """``1 / sqrt(squared)``, but 0 where the squared distance is nothing but rounding error.

    A squared distance that comes from ``|a|² + |b|² - 2 ab`` has an absolute error of a few roundings of
    ``|a|² + |b|²``. Below that, neither its root nor the root's slope means anything, and both are taken as
    those of a distance of 0, whose subgradient is 0. ``squared * inverse_distance(squared, norms)`` is the
    distance, and its gradient is finite everywhere.

    Args:
        squared: Squared distances ``(...)``, some of which rounding may have made negative.
        norms: ``|a|² + |b|²``, ``(...)`` as the result.
    """
    noise = 4 * torch.finfo(squared.dtype).eps
    return squared.masked_fill(squared <= noise * norms, torch.inf).rsqrt()
