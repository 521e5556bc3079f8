from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import GELU, Identity, Linear, Sequential, functional

from plp_lightning.methods.plp.losses import (
    domain_discriminator_loss,
    domain_generator_loss,
    domain_r1_penalty,
    standardise_jointly,
)


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
    assert domain_discriminator_loss(Identity(), logits).item() == pytest.approx(sum(own) / len(own), rel=1e-5)
    assert domain_generator_loss(Identity(), logits).item() == pytest.approx(sum(others) / len(others), rel=1e-5)


def test_two_domains_are_binary_cross_entropy_and_its_flipped_labels() -> None:
    logits = random_logits(3, 5)
    pooled = torch.cat(logits)
    odds, second = pooled[:, 1] - pooled[:, 0], torch.tensor([0.0] * 3 + [1.0] * 5)
    binary = functional.binary_cross_entropy_with_logits
    torch.testing.assert_close(domain_discriminator_loss(Identity(), logits), binary(odds, second))
    torch.testing.assert_close(domain_generator_loss(Identity(), logits), binary(odds, 1 - second))
    torch.testing.assert_close(
        domain_generator_loss(Identity(), logits), domain_discriminator_loss(Identity(), logits[::-1])
    )


@pytest.mark.parametrize("count", [2, 3, 5])
def test_who_cannot_tell_pays_the_log_of_the_number_of_domains(count: int) -> None:
    logits = [torch.zeros(3, count)] * count
    assert domain_discriminator_loss(Identity(), logits).item() == pytest.approx(math.log(count))
    assert domain_generator_loss(Identity(), logits).item() == pytest.approx(math.log(count))


def test_confusion_has_its_full_gradient_where_the_discriminator_is_sure() -> None:
    latent = torch.tensor([[-20.0]], requires_grad=True)
    sure = torch.cat([-latent, latent], dim=1)
    domain_generator_loss(Identity(), [sure, -sure.detach()]).backward()
    # d/dz of -log sigmoid(2 z) is -2 far below zero; half of the two samples is this one
    assert latent.grad is not None
    assert latent.grad.item() == pytest.approx(-1.0)


def test_discrimination_teaches_the_discriminator_alone() -> None:
    latents = [latent.requires_grad_() for latent in random_logits(3, 3)]
    discriminator = Linear(2, 2)
    domain_discriminator_loss(discriminator, latents).backward()
    assert all(latent.grad is None for latent in latents)
    assert discriminator.weight.grad is not None
    assert discriminator.weight.grad.abs().max() > 0


@pytest.mark.parametrize("sizes", [(4, 2), (3, 1, 2)])
def test_slope_is_that_of_finite_differences(sizes: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    judge = Sequential(Linear(3, 5), GELU(), Linear(5, len(sizes)))
    latents, step, found = [torch.randn(size, 3) for size in sizes], 1e-2, 0.0

    def odds(latent: Tensor, own: int) -> float:
        probability = judge(latent).double().softmax(0)[own].item()
        return math.log(probability / (1 - probability))

    for own, latent in enumerate(latents):
        for row in latent:
            ahead, behind = (row + sign * step * torch.eye(3) for sign in (1, -1))
            found += sum(((odds(a, own) - odds(b, own)) / (2 * step)) ** 2 for a, b in zip(ahead, behind, strict=True))
    assert domain_r1_penalty(judge, latents).item() == pytest.approx(found / sum(sizes) / 2, rel=1e-2)


def test_slope_teaches_the_discriminator_alone() -> None:
    judge, latents = Linear(2, 2), [latent.requires_grad_() for latent in random_logits(3, 3)]
    domain_r1_penalty(judge, latents).backward()
    assert all(latent.grad is None for latent in latents)
    assert judge.weight.grad is not None
    assert judge.weight.grad.abs().max() > 0


def test_units_of_spread_feel_neither_scale_nor_shift_and_are_constant_to_gradients() -> None:
    latents = [latent.requires_grad_() for latent in random_logits(4, 6)]
    seen = standardise_jointly(latents)
    pooled = torch.cat(seen)
    torch.testing.assert_close(pooled.mean(0), torch.zeros(2))
    assert pooled.std(0).mean().item() == pytest.approx(1)
    for same, other in zip(seen, standardise_jointly([1e-3 * latent - 5 for latent in latents]), strict=True):
        torch.testing.assert_close(same, other, rtol=1e-2, atol=1e-2)
    (found,) = torch.autograd.grad(seen[0].sum(), latents[0])
    torch.testing.assert_close(found, torch.ones(4, 2) / torch.cat(latents).std(0).mean())


def test_latents_that_are_all_the_same_stay_finite() -> None:
    assert all(latent.eq(0).all() for latent in standardise_jointly([torch.ones(2, 3), torch.ones(1, 3)]))


def test_half_precision_logits_are_compared_in_float32() -> None:
    logits = [part.bfloat16() for part in random_logits(4, 4)]
    expected = domain_discriminator_loss(Identity(), [part.float() for part in logits])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        torch.testing.assert_close(domain_discriminator_loss(Identity(), logits), expected, rtol=0, atol=0)


def test_shapes_are_checked() -> None:
    with pytest.raises(AssertionError, match="at least two domains, got 1"):
        domain_discriminator_loss(Identity(), [torch.zeros(3, 1)])
    with pytest.raises(AssertionError, match=r"expected logits \(6, 2\), got \(6, 1\)"):
        domain_generator_loss(Linear(4, 1), [torch.zeros(3, 4), torch.zeros(3, 4)])
