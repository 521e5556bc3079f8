from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.types import Batch
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods import Adaptation


class Watched(Adaptation):
    """Computes each step's loss a second time, with a full pass through the policy."""

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss = super().training_step(batch, batch_idx)
        steps = batch.steps
        out = self.policy({d: s.observation for d, s in steps.items()}, {d: s.task for d, s in steps.items()})
        full = behavioural_cloning(out.action, {d: s.action for d, s in steps.items()})
        torch.testing.assert_close(loss, full)
        self.domains = getattr(self, "domains", set()) | set(steps)
        return loss


@pytest.fixture
def adapted(trajectory_file: Path, make_trainer: Callable[..., Trainer]) -> tuple[Watched, dict[str, Tensor]]:
    data = tiny.data_module(trajectory_file)
    phase = Watched(tiny.policy(data), optimizer=tiny.adamw(3e-3, 0.1))
    before = {name: value.clone() for name, value in phase.state_dict().items()}
    make_trainer(FreezeGuard(), epochs=3).fit(phase, datamodule=data)
    return phase, before


def test_only_the_common_policy_changes(adapted: tuple[Watched, dict[str, Tensor]]) -> None:
    phase, before = adapted
    changed = {name for name, value in phase.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if name.startswith("policy.common.")}
    assert len(changed) == 10


def test_both_domains_are_trained_on_with_the_loss_of_a_full_pass(adapted: tuple[Watched, dict[str, Tensor]]) -> None:
    assert adapted[0].domains == {"flat", "tall"}


def test_cached_latents_are_fresh_latents(adapted: tuple[Watched, dict[str, Tensor]], trajectory_file: Path) -> None:
    phase, data = adapted[0], tiny.data_module(trajectory_file)
    for domain, dataset in data.datasets.items():
        fresh = phase.policy.encode({domain: dataset.observation.take(slice(len(dataset)))})[domain]
        torch.testing.assert_close(phase.states[domain], fresh)
        assert not phase.states[domain].requires_grad


def test_the_optimiser_holds_the_common_policy_alone_even_without_a_guard(trajectory_file: Path) -> None:
    phase = Adaptation(
        tiny.policy(tiny.data_module(trajectory_file)), optimizer=tiny.adamw(0.25, 0.5), lr_scheduler=None
    )
    optimizer = phase.configure_optimizers()
    held = [id(parameter) for group in optimizer.param_groups for parameter in group["params"]]
    assert held == [id(parameter) for parameter in phase.policy.common.parameters()]
    assert [(group["lr"], group["weight_decay"]) for group in optimizer.param_groups] == [(0.25, 0.5)]


def test_frozen_and_trained_parts_make_up_the_whole_policy(trajectory_file: Path) -> None:
    phase = Adaptation(tiny.policy(tiny.data_module(trajectory_file)))
    frozen = {name for part, module in phase.frozen.items() for name in (f"{part}.{n}" for n in module.state_dict())}
    common = {f"common.{name}" for name in phase.policy.common.state_dict()}
    assert frozen | common == set(phase.policy.state_dict())
    assert not frozen & common


def test_the_common_policy_learns_through_the_frozen_decoder(adapted: tuple[Watched, dict[str, Tensor]]) -> None:
    phase = adapted[0]
    assert all(not parameter.requires_grad for parameter in phase.policy.decoder.parameters())
    assert all(parameter.requires_grad for parameter in phase.policy.common.parameters())
    assert not phase.policy.encoder.training
