"""Temporal cycle consistency: a frame that looks for itself through another demonstration must find itself."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from plp_lightning.methods.plp.losses.distance import full_precision, inverse_distance

Similarity = Literal["distance", "squared", "scaled"]
TEMPERATURE = 0.1
"""Temperature of the ``scaled`` softmax, as the authors of TCC set it."""


def tcc(
    first: Tensor,
    first_mask: Tensor,
    second: Tensor,
    second_mask: Tensor,
    first_softmax: Similarity = "distance",
    reduction: Literal["mean", "sum"] = "mean",
) -> Tensor:
    r"""Cycle loss over pairs of encoded demonstrations of the same task, one of each of two domains.

    .. math::
        \tilde v_i &= \sum_j \mathrm{softmax}_j(-\| u_i - v_j \|) \, v_j \\
        L_{TCC} &= - \sum_i \log \mathrm{softmax}_k(-\| \tilde v_i - u_k \|^2)_{k=i}

    Mean of the cycles u → v → u and v → u → v, and mean over pairs. Only valid frames are looked for or found.
    See "Cross-Domain Policy Transfer by Representation Alignment via Multi-Domain Behavioral Cloning"
    (https://arxiv.org/abs/2407.16912), the equation of L_TCC in section 4.1, and "Temporal Cycle-Consistency
    Learning" (https://arxiv.org/abs/1904.07846), Eq. 2 and 3 (which square the first distance too).

    Args:
        first: Latents u, ``(P, T1, Z)``.
        first_mask: ``(P, T1)`` bool, False behind the end of a trajectory; at least one frame is valid.
        second: Latents v, ``(P, T2, Z)``; row p demonstrates the task of ``first[p]``.
        second_mask: ``(P, T2)`` bool.
        first_softmax: Logits of the soft nearest neighbour: minus the ``distance`` (as printed), the distance
            ``squared``, or ``scaled``: squared, over 0.1 Z (as in the code of TCC's authors).
        reduction: Over the frames of one trajectory: their ``mean``, so that long demonstrations weigh as much
            as short ones (as in the code of TCC's authors), or their ``sum`` (as printed).

    Returns:
        Scalar; float32 whatever autocast says. Trajectories of a single frame cost nothing.

    Example:
        >>> walk, valid = torch.arange(4.0).view(1, 4, 1) * 100, torch.ones(1, 4, dtype=torch.bool)
        >>> tcc(walk, valid, walk, valid)
        tensor(0.)
    """
    _assert_shapes(first, first_mask, second, second_mask)
    with torch.autocast(first.device.type, enabled=False):
        # The origin is moved into each pair: distances don't feel it, but their rounding does.
        origin = full_precision(first.detach()[:, :1])
        u, v = full_precision(first) - origin, full_precision(second) - origin
        product = u @ v.mT  # (P, T1, T2)
        u_norm, v_norm = u.square().sum(-1), v.square().sum(-1)
        norms = u_norm[:, :, None] + v_norm[:, None]
        similarity = _similarity(norms - 2 * product, norms.detach(), first_softmax, size=u.shape[-1])
        there = _cycle(similarity, product, u_norm, first_mask, second_mask)
        back = _cycle(similarity.mT, product.mT, v_norm, second_mask, first_mask)
    if reduction == "mean":
        there, back = there / first_mask.sum(1), back / second_mask.sum(1)
    return (there + back).mean() / 2


def _similarity(squared: Tensor, norms: Tensor, kind: Similarity, size: int) -> Tensor:
    """Logits of the soft nearest neighbour; same shape as the squared distances."""
    if kind == "distance":
        return -squared * inverse_distance(squared, norms)
    return -squared if kind == "squared" else squared / (-TEMPERATURE * size)


def _cycle(similarity: Tensor, product: Tensor, norm: Tensor, mask: Tensor, other_mask: Tensor) -> Tensor:
    """Cross-entropy of coming back to the own frame, summed over the valid frames.

    The second softmax needs no soft neighbour in the latent space: ``-|ṽ - u|²`` is ``2 ṽu - |u|²`` plus a
    number that is the same for all u, and ``ṽu`` is a weighted mean of products that are known already. Takes the
    logits of the soft nearest neighbour and inner products ``(P, T, T')``, ``|u|²`` and the valid frames ``(P, T)`` of
    the trajectory that is left and returned to, and those ``(P, T')`` of the other; gives ``(P,)``.
    """
    never = torch.finfo(similarity.dtype).min
    weights = similarity.masked_fill(~other_mask[:, None], never).softmax(-1)  # (P, T, T')
    logits = 2 * weights @ product.mT - norm[:, None]  # (P, T, T)
    found = logits.masked_fill(~mask[:, None], never).logsumexp(-1) - logits.diagonal(dim1=1, dim2=2)
    return found.masked_fill(~mask, 0).sum(-1)


def _assert_shapes(first: Tensor, first_mask: Tensor, second: Tensor, second_mask: Tensor) -> None:
    assert first.ndim == 3, f"expected latents (P, T, Z), got {tuple(first.shape)}"
    expected = (first.shape[0], second.shape[1], first.shape[2])
    assert second.shape == expected, f"expected latents {expected}, got {tuple(second.shape)}"
    for latents, mask in ((first, first_mask), (second, second_mask)):
        shape = tuple(latents.shape[:2])
        assert mask.shape == shape, f"expected a mask {shape}, got {tuple(mask.shape)}"
        assert mask.dtype is torch.bool, f"expected a bool mask, got {mask.dtype}"
