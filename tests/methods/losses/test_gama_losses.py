from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from plp_lightning.methods.gama.losses import (
    normalised_prediction_error,
    transition_discriminator_loss,
    transition_generator_loss,
)

LAST = torch.tensor([False, True, False, False])
"""Which of four steps no observation follows, in files that do not know what was seen last."""


def numbers(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def slow_unexplained_change(prediction: Tensor, state: Tensor, following: Tensor, last: Tensor) -> float:
    shares = []
    for column in range(state.shape[1]):
        error = change = 0.0
        for row in range(len(state)):
            if not last[row]:
                error += float(prediction[row, column] - following[row, column]) ** 2
                change += float(following[row, column] - state[row, column]) ** 2
        shares.append(error / change)
    return sum(shares) / len(shares)


def slow_mean_log(logits: Tensor, last: Tensor, real: bool) -> float:
    chances = [1 / (1 + math.exp(-float(x))) for x, ends in zip(logits, last, strict=True) if not ends]
    return sum(-math.log(p if real else 1 - p) for p in chances) / len(chances)


def test_unexplained_change_is_a_mean_of_quotients() -> None:
    prediction, state, following = (numbers(4, 3, seed=i) for i in range(3))
    found = normalised_prediction_error(*(x[~LAST] for x in (prediction, state, following)))
    assert float(found) == pytest.approx(slow_unexplained_change(prediction, state, following, LAST))


def test_unexplained_change_of_known_predictions() -> None:
    state, following = numbers(4, 3), numbers(4, 3, seed=1)
    assert float(normalised_prediction_error(state, state, following)) == pytest.approx(1)
    assert float(normalised_prediction_error(following, state, following)) == 0
    half = (state + following) / 2
    assert float(normalised_prediction_error(half, state, following)) == pytest.approx(0.25)


def test_unexplained_change_knows_no_unit() -> None:
    prediction, state, following = (numbers(4, 3, seed=i) for i in range(3))
    unit = torch.tensor([1e-3, 1.0, 1e3], dtype=torch.float64)
    plain = normalised_prediction_error(prediction, state, following)
    torch.testing.assert_close(normalised_prediction_error(prediction * unit, state * unit, following * unit), plain)


def test_a_column_that_never_changes_gives_finite_gradients() -> None:
    state = torch.zeros(4, 2)
    following = torch.tensor([[0.0, 1.0]]).expand(4, 2)
    prediction = state.clone().requires_grad_()
    normalised_prediction_error(prediction, state, following).backward()
    assert prediction.grad is not None
    assert torch.isfinite(prediction.grad).all()
    assert (prediction.grad[:, 1] < 0).all()


def test_both_players_agree_with_logarithms_of_probabilities() -> None:
    real, fake, other = numbers(4), numbers(3, seed=1), torch.tensor([False, False, True])
    expected = slow_mean_log(real, LAST, real=True) + slow_mean_log(fake, other, real=False)
    assert float(transition_discriminator_loss(real[~LAST], fake[~other])) == pytest.approx(expected)
    assert float(transition_generator_loss(fake[~other])) == pytest.approx(slow_mean_log(fake, other, real=True))


def test_the_players_pull_at_translated_transitions_in_opposite_directions() -> None:
    fake = numbers(5).requires_grad_()
    (apart,) = torch.autograd.grad(transition_discriminator_loss(numbers(5), fake), fake)
    (towards,) = torch.autograd.grad(transition_generator_loss(fake), fake)
    assert (apart > 0).all()
    assert (towards < 0).all()


def test_translators_learn_most_where_they_are_found_out() -> None:
    fake = torch.tensor([-20.0, 20.0]).requires_grad_()
    transition_generator_loss(fake).backward()
    assert fake.grad is not None
    torch.testing.assert_close(fake.grad, torch.tensor([-0.5, 0.0]), atol=1e-6, rtol=0)
