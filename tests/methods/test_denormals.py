"""Gradients without the smallest floats, and everything else with them."""

from __future__ import annotations

import pytest
import torch

from plp_lightning.methods.contextual.denormals import without_denormals

SMALL = 1e-39


def told() -> bool:
    """Whether this thread takes the smallest floats for 0."""
    return bool((torch.tensor([SMALL]) * 1.0).item() == 0)


@pytest.mark.skipif(not torch.set_flush_denormal(False), reason="this processor always counts with them")
def test_the_smallest_floats_are_zero_while_gradients_are_found_and_not_before_or_after() -> None:
    weight, seen = torch.tensor([3.0], requires_grad=True), []
    weight.register_hook(lambda gradient: seen.append((told(), gradient.item())))
    for factor in (SMALL, 1.0):
        without_denormals((weight * factor).sum()).backward()
        assert not told()
    assert seen == [(True, 0.0), (True, 1.0)]


def test_a_loss_without_gradients_stays_as_it_is() -> None:
    loss = torch.tensor(2.0)
    assert without_denormals(loss) is loss
