from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.transfer import TransferDataModule
from datamodules.types import Batch
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.losses import behavioural_cloning
from plp_lightning.methods import Adaptation, PortablePolicy
from plp_lightning.methods.plp.losses import support_distance
from plp_lightning.methods.plp.support import KNOWN


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


def supported(data: TransferDataModule, weight: float) -> Adaptation:
    torch.manual_seed(1)
    return Adaptation(tiny.policy(data), optimizer=tiny.adamw(3e-3, 0.0), lr_scheduler=None, support_weight=weight)


def away(phase: Adaptation, data: TransferDataModule, known: Tensor) -> float:
    """Distance of the target task's latent actions in the source domain from known ones."""
    own = of_aligned(phase.policy, data, data.source_domain, data.target_tasks)
    return support_distance({data.source_domain: own}, known).item()


def test_known_are_the_latent_actions_of_proxy_tasks_before_adaptation(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = supported(data, 1.0)
    aligned = copy.deepcopy(phase.policy)
    make_trainer(FreezeGuard(), epochs=2).fit(phase, datamodule=data)
    assert phase.known.shape == (KNOWN, phase.policy.latent_size)
    for domain, half in zip(data.domains, phase.known.split(KNOWN // 2), strict=True):
        known_to, unknown_to = (of_aligned(aligned, data, domain, t) for t in (data.proxy_tasks, data.target_tasks))
        assert nearest(half, known_to).max() < 1e-6
        assert len(unknown_to) == 0 or nearest(half, unknown_to).min() > 1e-6


def nearest(own: Tensor, others: Tensor) -> Tensor:
    """Distance of each row to the nearest of others, without the rounding of a matrix product."""
    return torch.cdist(own, others, compute_mode="donot_use_mm_for_euclid_dist").min(dim=1).values


def of_aligned(policy: PortablePolicy, data: TransferDataModule, domain: str, tasks: Sequence[str]) -> Tensor:
    """Latent actions of all training steps of tasks."""
    rows = torch.from_numpy(data.rows(tasks, "train").get(domain, np.arange(0)))
    dataset = data.datasets[domain]
    with torch.no_grad():
        latent = policy.encode({domain: dataset.observation.take(rows)})
        return policy.latent_action(latent, {domain: dataset.task[rows]})[domain]


def test_support_keeps_latent_actions_near_those_of_proxy_tasks(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phases = {weight: supported(data, weight) for weight in (0.0, 1.0)}
    for phase in phases.values():
        make_trainer(epochs=8).fit(phase, datamodule=data)
    known = phases[1.0].known
    far, near = (away(phase, data, known) for phase in phases.values())
    assert near < 0.5 * far


def test_adaptation_that_goes_on_knows_what_it_knew(
    trajectory_file: Path, make_trainer: Callable[..., Trainer], tmp_path: Path
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = supported(data, 1.0)
    trainer = make_trainer(epochs=2)
    trainer.fit(phase, datamodule=data)
    trainer.save_checkpoint(tmp_path / "two.ckpt")
    later = supported(data, 1.0)
    later.policy.load_state_dict(phase.policy.state_dict())
    make_trainer(epochs=3).fit(later, datamodule=data, ckpt_path=tmp_path / "two.ckpt", weights_only=True)
    assert torch.equal(later.known, phase.known)


def test_without_support_nothing_is_kept(trajectory_file: Path) -> None:
    assert "known" not in supported(tiny.data_module(trajectory_file), 0.0).state_dict()
