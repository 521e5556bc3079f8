from __future__ import annotations

import pytest
import torch
from torch import Tensor

from plp_lightning.methods.cdil.losses import (
    cycle,
    position_gap,
    translation_discriminator_loss,
    translation_generator_loss,
)


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def one_by_one(value: Tensor, weight: Tensor) -> float:
    total = sum(weight.tolist())
    return sum(v * w for v, w in zip(value.tolist(), weight.tolist(), strict=True)) / total


def test_discriminator_loss_is_half_the_squared_distance_from_one_and_from_zero() -> None:
    real, made, of_real, of_made = draw(5), draw(7, seed=1), draw(5, seed=2).abs(), draw(7, seed=3).abs()
    by_hand = 0.5 * one_by_one((real - 1) ** 2, of_real) + 0.5 * one_by_one(made**2, of_made)
    assert translation_discriminator_loss(real, made, of_real, of_made).item() == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("real", "made", "loss"), [(1.0, 0.0, 0.0), (0.0, 1.0, 1.0), (0.5, 0.5, 0.25), (1.0, 1.0, 0.5)]
)
def test_discriminator_loss_of_known_judgements(real: float, made: float, loss: float) -> None:
    one = torch.ones(1)
    assert translation_discriminator_loss(torch.tensor([real]), torch.tensor([made]), one, one).item() == loss


def test_samples_without_weight_count_for_nothing() -> None:
    weight = torch.tensor([1.0, 0.0, 1.0])
    judged, other = torch.tensor([0.0, 77.0, 0.5]), torch.tensor([0.0, -5.0, 0.5])
    assert translation_generator_loss(judged, weight) == translation_generator_loss(other, weight) == 0.625
    assert translation_discriminator_loss(judged, judged, weight, weight) == translation_discriminator_loss(
        other, other, weight, weight
    )
    assert position_gap(judged, torch.zeros(3), weight) == position_gap(other, torch.zeros(3), weight) == 0.125


def test_a_batch_without_any_weight_costs_nothing_and_has_a_gradient() -> None:
    judged = torch.tensor([3.0, 4.0], requires_grad=True)
    loss = translation_generator_loss(judged, torch.zeros(2))
    loss.backward()
    assert loss.item() == 0
    assert judged.grad is not None
    assert judged.grad.tolist() == [0, 0]


def test_fooling_moves_judgements_up_and_discriminating_moves_them_down() -> None:
    judged, weight = torch.tensor([0.25], requires_grad=True), torch.ones(1)
    (up,) = torch.autograd.grad(translation_generator_loss(judged, weight), judged)
    (down,) = torch.autograd.grad(translation_discriminator_loss(torch.ones(1), judged, weight, weight), judged)
    assert (up.item(), down.item()) == (-1.5, 0.25)


def test_cycle_is_the_mean_absolute_difference() -> None:
    here, back = draw(2, 4, 3), draw(2, 4, 3, seed=1)
    by_hand = sum(abs(a - b) for a, b in zip(here.flatten().tolist(), back.flatten().tolist(), strict=True)) / 24
    assert cycle(here, back).item() == pytest.approx(by_hand)
    assert cycle(here, back) == cycle(back, here)
    assert cycle(here, here) == 0


def test_cycle_does_not_broadcast() -> None:
    with pytest.raises(AssertionError, match=r"expected \(4, 3\), got \(4, 1\)"):
        cycle(torch.zeros(4, 3), torch.zeros(4, 1))


def test_position_gap_is_the_weighted_squared_difference() -> None:
    here, abroad, weight = draw(6).sigmoid(), draw(6, seed=1).sigmoid(), draw(6, seed=2).abs()
    by_hand = one_by_one((here - abroad) ** 2, weight)
    assert position_gap(here, abroad, weight).item() == pytest.approx(by_hand)
