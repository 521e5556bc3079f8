"""Domain discrimination on latents: the adversarial alternative to the maximum mean discrepancy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional


def discrimination(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> Tensor:
    """The discriminator's loss: cross-entropy of telling which domain a latent is from.

    The latents are detached: no gradient reaches the encoder. For two domains this is the binary cross-entropy
    of "Generative Adversarial Networks" (https://arxiv.org/abs/1406.2661), Eq. 1.

    Args:
        discriminator: ``(B, Z)`` → logits ``(B, D)`` for D domains, two or more.
        latents: One tensor ``(B_d, Z)`` a domain, in the order of the logits.

    Returns:
        Scalar, mean over the samples of all domains.

    Example:
        >>> discrimination(torch.nn.Identity(), [torch.zeros(3, 2), torch.zeros(5, 2)])  # log 2: it can't tell
        tensor(0.6931)
    """
    logits, own = _judge(discriminator, [latent.detach() for latent in latents])
    return functional.cross_entropy(logits, own)


def confusion(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> Tensor:
    """The encoder's loss: cross-entropy with flipped labels, small if latents pass for another domain's.

    It doesn't saturate: the better the discriminator, the larger the gradient. With more than two domains the
    flipped label is any of the others, each as good. See "Generative Adversarial Networks"
    (https://arxiv.org/abs/1406.2661), section 3.

    Args:
        discriminator: As in :func:`discrimination`, its parameters held fixed: a gradient that reached them
            would teach it to be fooled.
        latents: One tensor ``(B_d, Z)`` a domain, in the order of the logits.

    Returns:
        Scalar, mean over the samples of all domains.

    Example:
        >>> told_apart = [torch.tensor([[9.0, 0.0]]), torch.tensor([[0.0, 9.0]])]
        >>> confusion(torch.nn.Identity(), told_apart)
        tensor(9.0001)
    """
    logits, own = _judge(discriminator, latents)
    return functional.cross_entropy(logits, (1 - own) / (len(latents) - 1))


def _judge(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Logits of all samples, and for each sample D probabilities, 1 for its own domain; both ``(B, D)``."""
    count, sizes = len(latents), [len(latent) for latent in latents]
    assert count >= 2, f"expected the latents of at least two domains, got {count}"
    logits = discriminator(torch.cat(list(latents))).float()
    expected = (sum(sizes), count)
    assert logits.shape == expected, f"expected logits {expected}, got {tuple(logits.shape)}"
    identity = torch.eye(count, device=logits.device)
    return logits, torch.cat([row.expand(size, -1) for row, size in zip(identity, sizes, strict=True)])
