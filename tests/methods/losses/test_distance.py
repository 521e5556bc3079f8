from __future__ import annotations

import pytest
import torch

from plp_lightning.methods.plp.losses.distance import full_precision, inverse_distance


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distances_above_the_rounding_error_are_kept_and_those_below_are_zero(dtype: torch.dtype) -> None:
    rounding = torch.finfo(dtype).eps
    squared = torch.tensor([4.0, 100 * rounding, 2 * rounding, 0.0, -rounding], dtype=dtype)
    kept = [0.5, (100 * rounding) ** -0.5]
    assert inverse_distance(squared, torch.ones_like(squared)).tolist() == pytest.approx([*kept, 0, 0, 0])


def test_the_error_is_relative_to_the_norms() -> None:
    squared = torch.full((2,), 1e-3)
    assert inverse_distance(squared, torch.tensor([1.0, 1e6])).tolist() == pytest.approx([1e-3**-0.5, 0])


def test_gradient_of_a_distance_is_that_of_the_root_or_zero() -> None:
    squared = torch.tensor([9.0, 0.0, -1e-9], requires_grad=True)
    (squared * inverse_distance(squared, torch.ones(3))).sum().backward()
    assert squared.grad is not None
    assert squared.grad.tolist() == pytest.approx([1 / 6, 0, 0])


def test_half_precision_is_raised_and_double_precision_is_kept() -> None:
    kinds = [torch.bfloat16, torch.float16, torch.float32, torch.float64]
    raised = [full_precision(torch.zeros(1, dtype=kind)).dtype for kind in kinds]
    assert raised == [torch.float32, torch.float32, torch.float32, torch.float64]
