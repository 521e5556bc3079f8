"""A mean in which samples count more or less, or not at all."""

from __future__ import annotations

from torch import Tensor


def weighted_mean(value: Tensor, weight: Tensor) -> Tensor:
    """Mean of ``value (B,)`` under ``weight (B,)``, bool or ≥ 0; 0 if all weights are 0.

    Example:
        >>> weighted_mean(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([True, True, False]))
        tensor(1.5000)
    """
    assert value.shape == weight.shape, f"expected one weight a sample {tuple(value.shape)}, got {tuple(weight.shape)}"
    total = weight.sum()
    return (value * weight).sum() / total.where(total > 0, 1)
