"""Penalty on a discriminator's slope at weighted samples."""

from __future__ import annotations

import torch
from torch import Tensor


def r1_penalty(judged: Tensor, real: Tensor, weight: Tensor) -> Tensor:
    r"""Half the squared slope of a discriminator at real samples ("R1").

    .. math:: \frac{1}{2} \mathbb{E}_{real} \| \nabla_x D(x) \|^2

    A discriminator that is as good as certain teaches nothing, or leads away from what is real. With this penalty the
    game of discriminator and generator has a point where both come to rest. See "Which Training Methods for GANs do
    actually Converge?" (https://arxiv.org/abs/1801.04406), Eq. 9, without its factor γ. The gradient of the scalar
    reaches the discriminator; it is 0 if all weights are 0.

    Args:
        judged: ``(B,)``, the discriminator's verdicts, each from its own row alone.
        real: ``(B, N)``, the samples, which require a gradient.
        weight: ``(B,)``, bool or at least 0.

    Example:
        >>> real = torch.ones(2, 3, requires_grad=True)
        >>> r1_penalty(real.square().sum(dim=1), real, torch.ones(2).bool())
        tensor(6., grad_fn=<DivBackward0>)
    """
    (slope,) = torch.autograd.grad(judged.sum(), real, create_graph=True)
    return weighted_mean(slope.square().sum(dim=1), weight) / 2


def weighted_mean(value: Tensor, weight: Tensor) -> Tensor:
    """Mean of ``value (B,)`` under ``weight (B,)``, bool or ≥ 0; 0 if all weights are 0.

    Example:
        >>> weighted_mean(torch.tensor([1.0, 2.0, 9.0]), torch.tensor([True, True, False]))
        tensor(1.5000)
    """
    assert value.shape == weight.shape, f"expected one weight a sample {tuple(value.shape)}, got {tuple(weight.shape)}"
    total = weight.sum()
    return (value * weight).sum() / total.where(total > 0, 1)
