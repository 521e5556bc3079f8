"""Squared error over one step, against loops and by hand."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from plp_lightning.methods.state_only.phases import one_step

SIZES = {"point": (7, 2), "ant": (4, 5)}


def made_up(seed: int) -> tuple[dict[str, Tensor], dict[str, Tensor], dict[str, Tensor]]:
    """Predictions, outcomes and steps that no observation follows, of two domains, in float64."""
    torch.manual_seed(seed)
    prediction = {d: torch.randn(b, n, dtype=torch.float64, requires_grad=True) for d, (b, n) in SIZES.items()}
    outcome = {d: torch.randn(b, n, dtype=torch.float64, requires_grad=True) for d, (b, n) in SIZES.items()}
    return prediction, outcome, {d: torch.rand(b) < 0.4 for d, (b, _) in SIZES.items()}


def slowly(prediction: dict[str, Tensor], outcome: dict[str, Tensor], last: dict[str, Tensor], reduction: str) -> float:
    """The mean over single steps but those that no observation follows, one number at a time."""
    errors = []
    for domain, predicted in prediction.items():
        for i in range(len(predicted)):
            if not last[domain][i]:
                squares = [(predicted[i, j] - outcome[domain][i, j]).item() ** 2 for j in range(predicted.shape[1])]
                errors.append(sum(squares) / (len(squares) if reduction == "mean" else 1))
    return sum(errors) / len(errors)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_is_the_mean_over_the_steps_that_something_follows(seed: int, reduction: str) -> None:
    prediction, outcome, last = made_up(seed)
    known = ({d: x[~last[d]] for d, x in part.items()} for part in (prediction, outcome))
    found = one_step(*known, reduction)  # type: ignore[arg-type,misc]
    assert found.item() == pytest.approx(slowly(*made_up(seed), reduction), rel=1e-12)


def test_by_hand() -> None:
    prediction = {"a": torch.tensor([[1.0, 2.0]]), "b": torch.tensor([[3.0]])}
    outcome = {"a": torch.tensor([[0.0, 0.0]]), "b": torch.tensor([[1.0]])}
    assert one_step(prediction, outcome).item() == pytest.approx((5 / 2 + 4) / 2)
    assert one_step(prediction, outcome, "sum").item() == pytest.approx((5 + 4) / 2)


def test_no_gradient_reaches_outcomes() -> None:
    prediction, outcome, _ = made_up(0)
    one_step(prediction, outcome).backward()
    for domain, predicted in prediction.items():
        assert outcome[domain].grad is None
        assert predicted.grad is not None
        assert (predicted.grad != 0).any(dim=1).all()


def test_shapes_are_checked() -> None:
    with pytest.raises(AssertionError, match=r"expected predictions \(3, 1\) in domain 'a', got \(3, 2\)"):
        one_step({"a": torch.zeros(3, 2)}, {"a": torch.zeros(3, 1)})
    with pytest.raises(AssertionError, match=r"predictions of \['a'\], actions of \['b'\]"):
        one_step({"a": torch.zeros(3, 2)}, {"b": torch.zeros(3, 2)})
    with pytest.raises(AssertionError, match="expected at least one domain"):
        one_step({}, {})
