"""A discriminator of domains on latents: the adversarial alternative to the maximum mean discrepancy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from plp_lightning.losses import r1_penalty


def domain_discriminator_loss(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> Tensor:
    """The discriminator's loss, a scalar: cross-entropy of a latent's domain, mean over all domains' samples.

    The latents are detached: no gradient reaches the encoder. For two domains this is the binary cross-entropy
    of "Generative Adversarial Networks" (https://arxiv.org/abs/1406.2661), Eq. 1.

    Args:
        discriminator: ``(B, Z)`` → logits ``(B, D)`` for D domains, two or more.
        latents: One tensor ``(B_d, Z)`` a domain, in the order of the logits.

    Example:
        >>> alike = [torch.zeros(3, 2), torch.zeros(5, 2)]
        >>> domain_discriminator_loss(torch.nn.Identity(), alike)  # log 2: it can't tell
        tensor(0.6931)
    """
    logits, own = _judge(discriminator, [latent.detach() for latent in latents])
    return functional.cross_entropy(logits, own)


def domain_generator_loss(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> Tensor:
    """The encoder's loss, a scalar: cross-entropy with flipped labels, small if latents pass for another domain's.

    It doesn't saturate: the better the discriminator, the larger the gradient. With more than two domains the
    flipped label is any of the others, each as good. See "Generative Adversarial Networks"
    (https://arxiv.org/abs/1406.2661), section 3.

    Args:
        discriminator: ``(B, Z)`` → ``(B, D)``, its parameters held fixed: a gradient would teach it to be fooled.
        latents: One tensor ``(B_d, Z)`` a domain, in the order of the logits.

    Example:
        >>> told_apart = [torch.tensor([[9.0, 0.0]]), torch.tensor([[0.0, 9.0]])]
        >>> domain_generator_loss(torch.nn.Identity(), told_apart)
        tensor(9.0001)
    """
    logits, own = _judge(discriminator, latents)
    return functional.cross_entropy(logits, (1 - own) / (len(latents) - 1))


def domain_r1_penalty(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> Tensor:
    """The discriminator's penalty, a scalar: half the squared slope of the log-odds it gives a latent's own domain.

    Where the domains overlap, the discriminator could go on telling single latents apart by ever steeper logits, and
    the encoder would be led by these instead of by where the domains lie. See :func:`r1_penalty`, to which
    the latents of every domain are real ones here. The gradient reaches the discriminator alone.

    Args:
        discriminator: ``(B, Z)`` → ``(B, D)``.
        latents: One tensor ``(B_d, Z)`` a domain, in the order of the logits.

    Example:
        >>> latents = [torch.zeros(4, 1), torch.ones(2, 1)]
        >>> domain_r1_penalty(lambda latent: torch.cat([3 * latent, -latent], dim=1), latents)
        tensor(8., grad_fn=<DivBackward0>)
    """
    real = torch.cat([latent.detach() for latent in latents]).requires_grad_()
    logits, own = _judge(discriminator, real.split([len(latent) for latent in latents]))
    odds = (own * logits).sum(dim=1) - logits.masked_fill(own > 0, -torch.inf).logsumexp(dim=1)
    return r1_penalty(odds, real, torch.ones_like(odds))


def standardise_jointly(latents: Sequence[Tensor]) -> list[Tensor]:
    """Latents less their mean, over their mean standard deviation, both of all domains together and held constant.

    A discriminator's slope says how finely it looks only in a unit that grows and shrinks with the latents.

    Args:
        latents: One tensor ``(B_d, Z)`` a domain, two rows or more together.

    Example:
        >>> standardise_jointly([torch.tensor([[1.0]]), torch.tensor([[3.0]])])
        [tensor([[-0.7071]]), tensor([[0.7071]])]
    """
    pooled = torch.cat([latent.detach() for latent in latents])
    centre, spread = pooled.mean(dim=0), pooled.std(dim=0).mean()
    return [(latent - centre) / spread.clamp_min(torch.finfo(spread.dtype).tiny) for latent in latents]


def _judge(discriminator: Callable[[Tensor], Tensor], latents: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Logits of all samples, and for each sample D probabilities, 1 for its own domain; both ``(B, D)``."""
    count, sizes = len(latents), [len(latent) for latent in latents]
    assert count >= 2, f"expected the latents of at least two domains, got {count}"
    logits = discriminator(torch.cat(list(latents))).float()
    expected = (sum(sizes), count)
    assert logits.shape == expected, f"expected logits {expected}, got {tuple(logits.shape)}"
    identity = torch.eye(count, device=logits.device)
    return logits, torch.cat([row.expand(size, -1) for row, size in zip(identity, sizes, strict=True)])
