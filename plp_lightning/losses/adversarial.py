"""Domain discrimination on latents: the adversarial alternative to the maximum mean discrepancy."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional


def discriminator_loss(logits: Sequence[Tensor]) -> Tensor:
    """The discriminator's loss: cross-entropy of telling which domain a latent is from.

    The logits are those of detached latents, so that no gradient reaches the encoder. See "Generative
    Adversarial Networks" (https://arxiv.org/abs/1406.2661), Eq. 1.

    Args:
        logits: What the discriminator says of each domain's latents, ``(B_d, D)`` for D domains, two or more,
            columns in the order of this list.

    Returns:
        Scalar, mean over the samples of all domains.

    Example:
        >>> discriminator_loss([torch.zeros(3, 2), torch.zeros(5, 2)])  # log 2: it can't tell
        tensor(0.6931)
    """
    pooled, own = _pool(logits)
    return functional.cross_entropy(pooled, own)


def domain_confusion(logits: Sequence[Tensor]) -> Tensor:
    """The encoder's loss: cross-entropy with flipped labels, small if latents pass for another domain's.

    It doesn't saturate: the better the discriminator, the larger the gradient. With more than two domains the
    flipped label is any of the others, each as good. See "Generative Adversarial Networks"
    (https://arxiv.org/abs/1406.2661), section 3.

    Args:
        logits: As in :func:`discriminator_loss`, but of latents whose gradient reaches the encoder, and from a
            discriminator whose parameters are held fixed.

    Returns:
        Scalar, mean over the samples of all domains.

    Example:
        >>> domain_confusion([torch.tensor([[9.0, 0.0]]), torch.tensor([[0.0, 9.0]])])  # it can tell
        tensor(9.0001)
    """
    pooled, own = _pool(logits)
    return functional.cross_entropy(pooled, (1 - own) / (len(logits) - 1))


def _pool(logits: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Logits of all samples, and for each sample D probabilities, 1 for its own domain."""
    count, shapes = len(logits), [tuple(part.shape) for part in logits]
    assert count >= 2, f"expected the logits of at least two domains, got {count}"
    assert all(len(s) == 2 and s[1] == count for s in shapes), f"expected logits (B_d, {count}), got {shapes}"
    pooled = torch.cat(list(logits)).float()
    identity = torch.eye(count, device=pooled.device)
    return pooled, torch.cat([row.expand(size, -1) for row, (size, _) in zip(identity, shapes, strict=True)])
