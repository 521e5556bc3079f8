from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import Identity, Linear, functional

from plp_lightning.losses import confusion, discrimination


def log_probability(row: list[float], domain: int) -> float:
    return row[domain] - math.log(sum(math.exp(logit) for logit in row))


def random_logits(*sizes: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(size, len(sizes), generator=generator) for size in sizes]


@pytest.mark.parametrize("sizes", [(4, 4), (2, 5), (3, 1, 4), (2, 2, 2, 2)])
def test_both_losses_equal_loops_over_samples(sizes: tuple[int, ...]) -> None:
    logits = random_logits(*sizes)
    rows = [(domain, row) for domain, part in enumerate(logits) for row in part.tolist()]
    own = [-log_probability(row, domain) for domain, row in rows]
    others = [
        -sum(log_probability(row, other) for other in range(len(sizes)) if other != domain) / (len(sizes) - 1)
        for domain, row in rows
    ]
    assert discrimination(Identity(), logits).item() == pytest.approx(sum(own) / len(own), rel=1e-5)
    assert confusion(Identity(), logits).item() == pytest.approx(sum(others) / len(others), rel=1e-5)


def test_two_domains_are_binary_cross_entropy_and_its_flipped_labels() -> None:
    logits = random_logits(3, 5)
    pooled = torch.cat(logits)
    odds, second = pooled[:, 1] - pooled[:, 0], torch.tensor([0.0] * 3 + [1.0] * 5)
    binary = functional.binary_cross_entropy_with_logits
    torch.testing.assert_close(discrimination(Identity(), logits), binary(odds, second))
    torch.testing.assert_close(confusion(Identity(), logits), binary(odds, 1 - second))
    torch.testing.assert_close(confusion(Identity(), logits), discrimination(Identity(), logits[::-1]))


@pytest.mark.parametrize("count", [2, 3, 5])
def test_who_cannot_tell_pays_the_log_of_the_number_of_domains(count: int) -> None:
    logits = [torch.zeros(3, count)] * count
    assert discrimination(Identity(), logits).item() == pytest.approx(math.log(count))
    assert confusion(Identity(), logits).item() == pytest.approx(math.log(count))


def test_confusion_has_its_full_gradient_where_the_discriminator_is_sure() -> None:
    latent = torch.tensor([[-20.0]], requires_grad=True)
    sure = torch.cat([-latent, latent], dim=1)
    confusion(Identity(), [sure, -sure.detach()]).backward()
    # d/dz of -log sigmoid(2 z) is -2 far below zero; half of the two samples is this one
    assert latent.grad is not None
    assert latent.grad.item() == pytest.approx(-1.0)


def test_discrimination_teaches_the_discriminator_alone() -> None:
    latents = [latent.requires_grad_() for latent in random_logits(3, 3)]
    discriminator = Linear(2, 2)
    discrimination(discriminator, latents).backward()
    assert all(latent.grad is None for latent in latents)
    assert discriminator.weight.grad is not None
    assert discriminator.weight.grad.abs().max() > 0


def test_half_precision_logits_are_compared_in_float32() -> None:
    logits = [part.bfloat16() for part in random_logits(4, 4)]
    expected = discrimination(Identity(), [part.float() for part in logits])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        torch.testing.assert_close(discrimination(Identity(), logits), expected, rtol=0, atol=0)


def test_shapes_are_checked() -> None:
    with pytest.raises(AssertionError, match="at least two domains, got 1"):
        discrimination(Identity(), [torch.zeros(3, 1)])
    with pytest.raises(AssertionError, match=r"expected logits \(6, 2\), got \(6, 1\)"):
        confusion(Linear(4, 1), [torch.zeros(3, 4), torch.zeros(3, 4)])
