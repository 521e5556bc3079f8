"""Maximum mean discrepancy: distance of the domains in the latent space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from plp_lightning.methods.plp.losses.distance import full_precision, inverse_distance

FAINT = -60.0  # Lower exponents add nothing in float32, and a processor is 50 times slower where floats end


def mmd(latents: Sequence[Tensor], scale_gradient: bool = True, bandwidths: Sequence[float] = (1.0,)) -> Tensor:
    r"""Squared maximum mean discrepancy between domains, mean over all pairs of domains.

    .. math::
        L_{MMD} &= \mathbb{E} f(x, x') + \mathbb{E} f(y, y') - 2 \, \mathbb{E} f(x, y) \\
        f(a, b) &= \sum_h \exp(-\|a - b\|^2 / (h m)^2)

    with m the mean distance between two different rows of the pooled batch, of all domains. A kernel sees gaps of about
    its own width: with h = 1 alone two domains may lie side by side at half the mean distance, each place in another
    direction, and the means over all places hardly differ; narrower kernels beside it see that. Where the gradient
    flows through m, scaling the latents changes nothing, so the loss can't be lowered by shrinking them; but a few rows
    that run far away raise m and with it f between all others, aligned or not. Where m counts as a constant, nothing is
    gained by that. Expectations are means over all pairs of rows, a row with itself included (the biased estimate), so
    that two samples of one distribution are about ``(1/B_x + 1/B_y)(1 - mean f)`` apart. See "Cross-Domain Policy
    Transfer by Representation Alignment via Multi-Domain Behavioral Cloning" (https://arxiv.org/abs/2407.16912), Eq. 2
    and its appendix on training details (h = 1), and "A Kernel Two-Sample Test"
    (https://jmlr.org/papers/v13/gretton12a.html), Eq. 5.

    Args:
        latents: One tensor ``(B_d, Z)`` for each of two or more domains; batch sizes may differ.
        scale_gradient: Let the gradient flow through m.
        bandwidths: Widths h of the kernels, in mean distances, above 0.

    Returns:
        Scalar, at least 0 up to rounding; float32 whatever autocast says. Differentiable once.

    Example:
        >>> mmd([torch.zeros(2, 3), torch.ones(2, 3)])
        tensor(1.7892)
    """
    shapes = [tuple(latent.shape) for latent in latents]
    assert len(shapes) >= 2, f"expected the latents of at least two domains, got {len(shapes)}"
    assert all(len(s) == 2 and s[0] > 0 and s[1] == shapes[0][1] for s in shapes), f"expected (B_d, Z), got {shapes}"
    pooled = full_precision(torch.cat(list(latents)))
    with torch.autocast(pooled.device.type, enabled=False):
        # Distances don't feel a shift, but the rounding of their matrix product does.
        centred = pooled - pooled.detach().mean(0)
        weights = pair_weights([size for size, _ in shapes], centred)
        return cast("Tensor", _KernelSum.apply(centred, weights, scale_gradient, bandwidths))  # type: ignore[no-untyped-call]


def pair_weights(sizes: Sequence[int], like: Tensor) -> Tensor:
    """Weight of each pair of pooled rows in the mean over pairs of domains.

    Args:
        sizes: Rows of each of the D domains, N in total.
        like: A tensor of the wanted dtype and device.

    Returns:
        ``(N, N)``, summing to 0. For rows of the domains c and d it is ``2 / (D (D - 1)) / (B_c B_d)``, times
        ``D - 1`` within a domain and ``-1`` across two.
    """
    count = len(sizes)
    domain = torch.eye(count, dtype=like.dtype, device=like.device)
    share = torch.cat([row.expand(size, -1) / size for row, size in zip(domain, sizes, strict=True)])  # (N, D)
    return share @ ((count * domain - 1) * (2 / (count * (count - 1)))) @ share.T


class _KernelSum(torch.autograd.Function):
    """``sum_h sum_ij w_ij exp(-s_ij / (h m)²)`` of the squared distances s between points, m the mean of their roots.

    Written out because automatic differentiation would cost a second matrix product (it doesn't know that s is
    symmetric) and twice the passes over ``(N, N)``::

        dL/ds_ij = -k_ij / m² + r / d_ij,  d_ij the root of s_ij
        k_ij = sum_h w_ij exp(-s_ij / (h m)²) / h²
        r = sum_ij k_ij s_ij / m³ / (N (N - 1)), or 0 where m counts as a constant
        dL/dx_i = 4 sum_j dL/ds_ij (x_i - x_j)
    """

    @staticmethod
    def forward(ctx: Any, points: Tensor, weights: Tensor, scale_gradient: bool, bandwidths: Sequence[float]) -> Tensor:
        """Points ``(N, Z)``, centred; weights ``(N, N)``, symmetric."""
        # |a - b|² = |a|² + |b|² - 2 ab: one product of matrices instead of (N, N, Z) differences.
        product = points @ points.T
        norm = product.diagonal().clone()
        squared = product.mul_(-2).add_(norm).add_(norm[:, None])  # (N, N), zero on the diagonal
        inverse = inverse_distance(squared, norm + norm[:, None])
        pairs = len(points) * (len(points) - 1)
        mean = torch.dot(squared.flatten(), inverse.flatten()) / pairs
        # All points in one place: the kernel is 1 and the slope 0.
        scale = torch.where(mean > 0, 1 / mean, 0)
        ratio = squared.mul_(scale.square())  # s / m²; from here on no distance has a unit
        total, kernel, slope = torch.zeros_like(mean), torch.zeros_like(ratio), torch.zeros_like(scale)
        for width in bandwidths:
            narrowed = (ratio * -(width**-2)).clamp_(min=FAINT).exp_().mul_(weights)
            total += narrowed.sum()
            kernel.add_(narrowed, alpha=width**-2)
        if scale_gradient:
            slope = torch.dot(kernel.flatten(), ratio.flatten()) * scale / pairs
        ctx.save_for_backward(points, kernel, inverse, scale, slope)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None, None]:
        """Gradient ``(N, Z)`` with respect to the points."""
        points, kernel, inverse, scale, slope = ctx.saved_tensors
        squared_grad = torch.addcmul(kernel * -scale.square(), inverse, slope)  # dL/ds, symmetric
        # sum_j g_ij (x_i - x_j) is the row sum times x_i, less one product: the differences never stand in memory.
        row = squared_grad.sum(1, keepdim=True)
        return 4 * grad * (row * points - squared_grad @ points), None, None, None
