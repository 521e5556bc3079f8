"""Penalty on a discriminator's slope."""

from __future__ import annotations

import torch
from torch import Tensor

from plp_lightning.losses.weighted_mean import weighted_mean


def r1_penalty(judged: Tensor, real: Tensor, weight: Tensor) -> Tensor:
    r"""Half the squared slope of a discriminator at real samples ("R1").

    .. math:: \frac{1}{2} \mathbb{E}_{real} \| \nabla_x D(x) \|^2

    A discriminator that is as good as certain teaches nothing, or leads away from what is real. With this penalty the
    game of discriminator and generator has a point where both come to rest. See "Which Training Methods for GANs do
    actually Converge?" (https://arxiv.org/abs/1801.04406), Eq. 9, without its factor γ.

    Args:
        judged: ``(B,)``, the discriminator's verdicts, each from its own row alone.
        real: ``(B, N)``, the samples, which require a gradient.
        weight: ``(B,)``, bool or at least 0.

    Returns:
        Scalar, whose gradient reaches the discriminator; 0 if all weights are 0.

    Example:
        >>> real = torch.ones(2, 3, requires_grad=True)
        >>> r1_penalty(real.square().sum(dim=1), real, torch.ones(2).bool())
        tensor(6., grad_fn=<DivBackward0>)
    """
    (slope,) = torch.autograd.grad(judged.sum(), real, create_graph=True)
    return weighted_mean(slope.square().sum(dim=1), weight) / 2
