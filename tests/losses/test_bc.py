from __future__ import annotations

from typing import Literal

import pytest
import torch

from plp_lightning.losses import behavioural_cloning


def test_means_over_dimensions_and_over_the_samples_of_all_domains() -> None:
    prediction = {"point": torch.tensor([[1.0, 2.0]]), "ant": torch.tensor([[0.0, 0.0, 3.0], [1.0, 1.0, 1.0]])}
    action = {"point": torch.tensor([[0.0, 0.0]]), "ant": torch.tensor([[0.0, 0.0, 1.0], [1.0, 1.0, 2.0]])}
    # (1 + 4) + (4) + (1) over three samples, and in the mean 5 / 2 + 4 / 3 + 1 / 3
    assert behavioural_cloning(prediction, action, "sum").item() == pytest.approx(10 / 3)
    assert behavioural_cloning(prediction, action).item() == pytest.approx(25 / 18)


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_equals_a_loop_over_samples_of_domains_with_different_sizes(reduction: Literal["mean", "sum"]) -> None:
    generator = torch.Generator().manual_seed(0)
    shapes = {"a": (5, 2), "b": (3, 8), "c": (1, 4)}
    prediction, action = (
        {name: torch.rand(shape, generator=generator, dtype=torch.float64) for name, shape in shapes.items()}
        for _ in range(2)
    )
    errors = [
        sum((p - a) ** 2 for p, a in zip(row.tolist(), other.tolist(), strict=True))
        / (len(row) if reduction == "mean" else 1)
        for name in shapes
        for row, other in zip(prediction[name], action[name], strict=True)
    ]
    assert behavioural_cloning(prediction, action, reduction).item() == pytest.approx(
        sum(errors) / len(errors), rel=1e-12
    )


def test_gradient_is_twice_the_error_over_all_samples() -> None:
    prediction = {"x": torch.tensor([[3.0]], requires_grad=True), "y": torch.tensor([[1.0]], requires_grad=True)}
    behavioural_cloning(prediction, {"x": torch.tensor([[1.0]]), "y": torch.tensor([[1.0]])}).backward()
    assert prediction["x"].grad == torch.tensor([[2.0]])
    assert prediction["y"].grad == torch.tensor([[0.0]])


def test_half_precision_predictions_are_compared_in_single_precision() -> None:
    prediction = {"x": torch.full((1000, 1), 1.0, dtype=torch.bfloat16)}
    loss = behavioural_cloning(prediction, {"x": torch.full((1000, 1), 0.999)})
    assert loss.item() == pytest.approx(1e-6, rel=1e-3)


def test_shapes_and_domains_are_checked() -> None:
    one, two = torch.zeros(4, 1), torch.zeros(4, 2)
    with pytest.raises(AssertionError, match="at least one domain"):
        behavioural_cloning({}, {})
    with pytest.raises(AssertionError, match=r"predictions of \['x'\], actions of \['y'\]"):
        behavioural_cloning({"x": one}, {"y": one})
    with pytest.raises(AssertionError, match=r"expected predictions \(4, 2\) in domain 'x', got \(4, 1\)"):
        behavioural_cloning({"x": one}, {"x": two})
    with pytest.raises(AssertionError, match=r"expected actions \(B, A\) in domain 'x', got \(4,\)"):
        behavioural_cloning({"x": torch.zeros(4)}, {"x": torch.zeros(4)})
