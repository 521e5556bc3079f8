from __future__ import annotations

import itertools

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from plp_lightning.losses import reconstruction


def pair(count: int, seed: int, sides: tuple[int, int] = (2, 3)) -> tuple[Tensor, Tensor]:
    """Predictions in [0, 1], float64, and uint8 images, both ``(count, H, W, 3)``."""
    draw = torch.Generator().manual_seed(seed)
    shape = (count, *sides, 3)
    image = torch.randint(0, 256, shape, dtype=torch.uint8, generator=draw)
    return torch.rand(shape, dtype=torch.float64, generator=draw), image


def pixel_by_pixel(prediction: dict[str, Tensor], image: dict[str, Tensor]) -> float:
    errors = [
        (predicted[place].item() - image[domain][place].item() / 255) ** 2
        for domain, predicted in prediction.items()
        for place in itertools.product(*map(range, predicted.shape))
    ]
    return sum(errors) / len(errors)


def test_by_hand() -> None:
    image = torch.tensor([0, 51, 255], dtype=torch.uint8).view(1, 1, 1, 3)
    prediction = torch.tensor([0.5, 0.2, 0.9]).view(1, 1, 1, 3)
    expected = (0.5**2 + 0 + 0.1**2) / 3
    assert reconstruction({"left": prediction}, {"left": image}).item() == pytest.approx(expected)


@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 99))
def test_is_the_mean_over_every_pixel_of_every_domain(first: int, second: int, seed: int) -> None:
    (one, seen_one), (other, seen_other) = pair(first, seed), pair(second, seed + 1)
    prediction, image = {"left": one, "right": other}, {"left": seen_one, "right": seen_other}
    assert reconstruction(prediction, image).item() == pytest.approx(pixel_by_pixel(prediction, image), rel=1e-6)


def test_a_perfect_memory_costs_nothing_and_noise_costs_its_variance() -> None:
    _, image = pair(200, 0)
    perfect = image / 255
    assert reconstruction({"left": perfect}, {"left": image}).item() < 1e-12
    noisy = perfect + 0.1 * torch.randn(perfect.shape, generator=torch.Generator().manual_seed(1))
    assert reconstruction({"left": noisy}, {"left": image}).item() == pytest.approx(0.01, rel=0.1)


def test_the_gradient_is_that_of_finite_differences() -> None:
    prediction, image = pair(2, 5)
    numbers = prediction.requires_grad_()
    assert torch.autograd.gradcheck(lambda p: reconstruction({"left": p}, {"left": image}), (numbers,))


def test_half_precision_predictions_are_compared_in_single_precision() -> None:
    prediction, image = pair(3, 7)
    loss = reconstruction({"left": prediction.bfloat16()}, {"left": image})
    assert loss.dtype is torch.float32
    assert loss.item() == pytest.approx(pixel_by_pixel({"left": prediction.bfloat16()}, {"left": image}), rel=1e-5)


def test_what_does_not_belong_together_is_refused() -> None:
    prediction, image = pair(2, 0)
    with pytest.raises(AssertionError, match="at least one camera"):
        reconstruction({}, {})
    with pytest.raises(AssertionError, match=r"predictions of \['left'\], images of \['right'\]"):
        reconstruction({"left": prediction}, {"right": image})
    for predicted, seen in ((prediction[:1], image), (prediction[0], image[0]), (prediction, image[:, :1])):
        with pytest.raises(AssertionError, match=r"expected images \(B, H, W, C\) for predictions \(.*\), got \(.*\)"):
            reconstruction({"left": predicted}, {"left": seen})
    with pytest.raises(AssertionError, match="expected uint8 images"):
        reconstruction({"left": prediction}, {"left": image.float()})


def test_a_smaller_prediction_is_compared_with_the_means_of_squares() -> None:
    prediction, _ = pair(2, 3, (2, 3))
    _, image = pair(2, 4, (4, 6))
    means = (image.double() / 255).view(2, 2, 2, 3, 2, 3).mean(dim=(2, 4))
    expected = (prediction - means).square().mean().item()
    assert reconstruction({"left": prediction}, {"left": image}).item() == pytest.approx(expected, rel=1e-6)
