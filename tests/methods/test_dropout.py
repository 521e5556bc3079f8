"""Dropout with few random bits beside what torch's own does."""

from __future__ import annotations

import pytest
import torch

from plp_lightning.methods.contextual.dropout import Dropout


@pytest.mark.parametrize("share", [0.1, 0.2, 0.5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float64])
def test_a_share_of_the_units_is_left_out_and_the_rest_is_larger(share: float, dtype: torch.dtype) -> None:
    torch.manual_seed(0)
    x = torch.ones(1001, 301, dtype=dtype, requires_grad=True)
    found = Dropout(share)(x)
    assert found.dtype is dtype
    assert float((found == 0).float().mean()) == pytest.approx(share, abs=0.004)  # five standard deviations
    kept = found[found != 0]
    rounding = 1e-2 if dtype is torch.bfloat16 else 1e-4
    torch.testing.assert_close(kept, torch.full_like(kept, 1 / (1 - share)), rtol=rounding, atol=0)
    found.sum().backward()
    assert x.grad is not None
    assert torch.equal(x.grad, found.detach())


def test_each_unit_is_drawn_by_itself() -> None:
    torch.manual_seed(0)
    kept = (Dropout(0.5)(torch.ones(2000, 64)) != 0).double()
    together = torch.corrcoef(kept.T) - torch.eye(64, dtype=torch.float64)
    assert float(together.abs().max()) < 0.12  # five standard deviations


def test_draws_are_those_of_torchs_generator() -> None:
    x, calls = torch.ones(10, 3), []
    for seed in (0, 0, 1):
        torch.manual_seed(seed)
        calls.append(Dropout(0.5)(x))
    assert torch.equal(calls[0], calls[1])
    assert not torch.equal(calls[0], calls[2])


def test_nothing_is_drawn_without_need() -> None:
    x, state = torch.randn(5), torch.get_rng_state()
    assert torch.equal(Dropout(0.3).eval()(x), x)
    assert torch.equal(Dropout(0.0)(x), x)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize("share", [1e-9, 1 - 1e-9])
def test_shares_near_the_ends_give_numbers(share: float) -> None:
    assert torch.isfinite(Dropout(share)(torch.ones(7))).all()
