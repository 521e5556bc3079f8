"""Gradients without the smallest floats, and everything else with them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from command import ROOT, plp, tiny_smoke
from torch import Tensor

from datamodules.types import Batch
from plp_lightning.methods.contextual.cloning import ContextualCloning
from plp_lightning.methods.contextual.denormals import SMALL, are_zero, without_denormals

pytestmark = pytest.mark.skipif(not torch.set_flush_denormal(False), reason="this processor always counts with them")


@pytest.fixture(params=[False, True], ids=["with them", "without them"])
def before(request: pytest.FixtureRequest) -> Iterator[bool]:
    """Whether the process took the smallest floats for 0 by itself."""
    torch.set_flush_denormal(request.param)
    yield request.param
    torch.set_flush_denormal(False)


def test_the_smallest_floats_are_zero_while_gradients_are_found_and_not_before_or_after() -> None:
    weight, seen = torch.tensor([3.0], requires_grad=True), []
    weight.register_hook(lambda gradient: seen.append((are_zero(), gradient.item())))
    for factor in (SMALL, 1.0):
        loss = (weight * factor).sum()
        with without_denormals():
            loss.backward()
        assert not are_zero()
    assert seen == [(True, 0.0), (True, 1.0)]


@pytest.mark.parametrize("fails", [False, True], ids=["found", "not found"])
def test_whatever_comes_of_gradients_the_process_counts_as_before(before: bool, fails: bool) -> None:
    weight, counted = torch.tensor([3.0], requires_grad=True), list[bool]()

    def hook(gradient: Tensor) -> None:
        counted.append(are_zero())
        if fails:
            raise ValueError("no gradient")

    weight.register_hook(hook)
    loss = weight.sum()
    with contextlib.suppress(ValueError), without_denormals():
        loss.backward()
    assert (weight.grad is None, counted) == (fails, [True])
    assert are_zero() == before


def test_all_steps_of_the_contextual_method_are_taken_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, original = list[bool](), ContextualCloning.training_step

    def watched(self: ContextualCloning, batch: Batch, batch_idx: int) -> Tensor:
        loss = original(self, batch, batch_idx)
        loss.register_hook(lambda gradient: seen.append(are_zero()))
        return loss

    monkeypatch.setattr(ContextualCloning, "training_step", watched)
    overlay = ["--config", ROOT / "configs" / "methods" / "contextual.yaml"]
    few = ["--data.pairs", 1, "--trainer.max_epochs", 1, "--trainer.log_every_n_steps", 7]  # some of them are bare
    assert plp("fit", *tiny_smoke(tmp_path), *overlay, *few).code == 0
    assert len(seen) > 3
    assert all(seen)
    assert not are_zero()
