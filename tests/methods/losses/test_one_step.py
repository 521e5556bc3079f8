"""Squared error over one step, against loops and by hand."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from plp_lightning.methods.state_only.losses import one_step

SIZES = {"point": (7, 2), "ant": (4, 5)}


def made_up(seed: int) -> tuple[dict[str, Tensor], dict[str, Tensor], dict[str, Tensor]]:
    """Predictions, outcomes and ends of two domains, in float64."""
    torch.manual_seed(seed)
    prediction = {d: torch.randn(b, n, dtype=torch.float64, requires_grad=True) for d, (b, n) in SIZES.items()}
    outcome = {d: torch.randn(b, n, dtype=torch.float64, requires_grad=True) for d, (b, n) in SIZES.items()}
    return prediction, outcome, {d: torch.rand(b) < 0.4 for d, (b, _) in SIZES.items()}


def slowly(prediction: dict[str, Tensor], outcome: dict[str, Tensor], last: dict[str, Tensor], reduction: str) -> float:
    """The mean over single steps, one number at a time."""
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
    found = one_step(*made_up(seed), reduction)  # type: ignore[arg-type]
    assert found.item() == pytest.approx(slowly(*made_up(seed), reduction), rel=1e-12)


def test_by_hand() -> None:
    prediction = {"a": torch.tensor([[1.0, 2.0], [0.0, 0.0]]), "b": torch.tensor([[3.0]])}
    outcome = {"a": torch.tensor([[0.0, 0.0], [7.0, 7.0]]), "b": torch.tensor([[1.0]])}
    last = {"a": torch.tensor([False, True]), "b": torch.tensor([False])}
    assert one_step(prediction, outcome, last).item() == pytest.approx((5 / 2 + 4) / 2)
    assert one_step(prediction, outcome, last, "sum").item() == pytest.approx((5 + 4) / 2)


def test_no_gradient_reaches_outcomes_or_comes_from_ends() -> None:
    prediction, outcome, last = made_up(0)
    one_step(prediction, outcome, last).backward()
    for domain, ends in last.items():
        assert outcome[domain].grad is None
        slope = prediction[domain].grad
        assert slope is not None
        assert ((slope == 0).all(dim=1) == ends).all()


def test_outcomes_of_ends_may_be_anything() -> None:
    prediction, outcome, last = made_up(1)
    unknown = {d: o.detach().masked_fill(last[d][:, None], torch.nan) for d, o in outcome.items()}
    loss = one_step(prediction, unknown, last)
    torch.testing.assert_close(loss, one_step(prediction, outcome, last))
    loss.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in prediction.values())


def test_nothing_follows_nothing_is_lost() -> None:
    ends = {"a": torch.ones(3, dtype=torch.bool)}
    assert one_step({"a": torch.ones(3, 2)}, {"a": torch.zeros(3, 2)}, ends).item() == 0


def test_shapes_are_checked() -> None:
    ends = torch.zeros(3, dtype=torch.bool)
    with pytest.raises(AssertionError, match=r"expected \(3, 2\) and \(3,\), got \(3, 1\) and \(3,\)"):
        one_step({"a": torch.zeros(3, 2)}, {"a": torch.zeros(3, 1)}, {"a": ends})
    with pytest.raises(AssertionError, match=r"\['a'\], \['b'\] and \['a'\] differ"):
        one_step({"a": torch.zeros(3, 2)}, {"b": torch.zeros(3, 2)}, {"a": ends})
    with pytest.raises(AssertionError, match="expected at least one domain"):
        one_step({}, {}, {})
