from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import seen
import tiny
import torch
from command import ROOT, SMOKE
from torch import Tensor, nn

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, BatchSpec
from plp_lightning.cli.config import parse
from plp_lightning.methods import CdilAdaptation, CdilAlignment, CdilDynamics, CdilPolicy, CdilPositions, Phase
from plp_lightning.methods.cdil.alignment import CdilWeights
from plp_lightning.methods.cdil.phases import CdilPhase
from plp_lightning.methods.optimization import slowed
from plp_lightning.networks import TaskNetwork

OVERLAY = ["--config", str(ROOT / "configs" / "methods" / "cdil.yaml")]
PHASES = (CdilPositions, CdilAlignment, CdilDynamics, CdilAdaptation)
TRAINED = {
    CdilPositions: {"positions", "perception"},
    CdilAlignment: {"translator", "pace"},
    CdilDynamics: {"inverse_dynamics"},
    CdilAdaptation: {"clones"},
}


class Place:
    """What a phase and its data know of each other, without a trainer."""

    def __init__(self, data: TransferDataModule, phase: CdilPhase) -> None:
        self.datamodule, self.lightning_module = data, phase


@pytest.fixture
def data(trajectory_file: Path) -> TransferDataModule:
    return tiny.data_module(trajectory_file, batch_size=64)


@pytest.fixture
def policy(data: TransferDataModule) -> CdilPolicy:
    torch.manual_seed(0)
    return CdilPolicy(
        data.problem, latent=8, hidden=16, translator_encoder_layers=1, policy_layers=1, translator_decoder_layers=1
    )


def begin(phase: CdilPhase, data: TransferDataModule, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Phase, "trainer", Place(data, phase))
    monkeypatch.setattr(data, "trainer", Place(data, phase))
    phase.on_fit_start()


def first_batch(data: TransferDataModule, batch_spec: BatchSpec) -> Batch:
    return next(iter(data.loader(batch_spec)))


def gradients(loss: Tensor, module: nn.Module) -> float:
    found = torch.autograd.grad(loss, [*module.parameters()], retain_graph=True, allow_unused=True)
    return sum(float(g.abs().sum()) for g in found if g is not None)


@pytest.mark.parametrize("kind", PHASES, ids=lambda kind: kind.__name__)
def test_a_phase_freezes_what_it_does_not_train(kind: type[CdilPhase], policy: CdilPolicy) -> None:
    children = {name for name, _ in policy.named_children()}
    assert set(kind(policy).frozen) - {"scaler"} == children - TRAINED[kind]  # type: ignore[call-arg]


def test_the_scaling_is_frozen_even_where_the_rest_of_perception_learns(policy: CdilPolicy) -> None:
    assert CdilPositions(policy).frozen["scaler"] is policy.perception.scaler


@pytest.mark.parametrize("kind", PHASES, ids=lambda kind: kind.__name__)
def test_the_losses_of_a_phase_teach_what_it_trains_and_hold_out_comparable_ones(
    kind: type[CdilPhase], data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = kind(policy)  # type: ignore[call-arg]
    begin(phase, data, monkeypatch)
    parts = phase.losses(first_batch(data, phase.batch_spec))
    total = torch.stack([*parts.values()]).sum()
    taught = {name for name, part in policy.named_children() if [*part.parameters()] and gradients(total, part) > 0}
    assert taught >= TRAINED[kind] - {"pace", "perception"}
    held_out = [phase.held_out_losses(batch) for batch in data.val_dataloader()]
    assert all(set(found) <= set(parts) for found in held_out)
    assert any(held_out)


def test_positions_are_regressed_to_the_share_that_lies_behind(data: TransferDataModule, policy: CdilPolicy) -> None:
    phase = CdilPositions(policy)
    batch = first_batch(data, phase.batch_spec)
    errors = []
    for domain, role in policy.roles.items():
        steps = batch.steps[domain]
        assert steps.progress is not None
        for i, progress in enumerate(steps.progress.tolist()):
            state = policy.perception.scaler(steps.observation.state[i : i + 1], domain)
            errors.append((policy.position(state, steps.task[i : i + 1], role).item() - progress) ** 2)
    assert phase.losses(batch)["position"].item() == pytest.approx(float(np.mean(errors)), rel=1e-4)


def test_inverse_dynamics_learn_from_target_steps_and_what_is_seen_after_them(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilDynamics(policy)
    begin(phase, data, monkeypatch)
    batch = first_batch(data, phase.batch_spec)
    steps = batch.steps["tall"]
    assert steps.next_observation is not None
    now, then = (policy.perception.scaler(x.state, "tall") for x in (steps.observation, steps.next_observation))
    expected = (policy.infer(now, then) - steps.action).square().mean()
    torch.testing.assert_close(phase.losses(batch)["inverse_dynamics"], expected)
    assert phase.held_out_losses(Batch({"flat": batch.steps["flat"]}, {})) == {}


def of_task(batch: Batch, policy: CdilPolicy, domain: str, names: Sequence[str]) -> Tensor:
    return torch.isin(batch.steps[domain].task, torch.tensor([policy.tasks[name] for name in names]))


def test_the_target_task_takes_part_in_both_cycles_and_in_nothing_else(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilAlignment(policy, noise=0.0, discriminator_hidden=8, discriminator_layers=1)
    begin(phase, data, monkeypatch)
    batch = first_batch(data, phase.batch_spec)
    rows = of_task(batch, policy, "flat", [tiny.TARGET])
    assert 0 < rows.sum() < len(rows)
    assert not of_task(batch, policy, "tall", [tiny.TARGET]).any()
    before = phase.losses(batch)
    phase.states["flat"][batch.steps["flat"].row[rows]] += 0.3
    after = phase.losses(batch)
    assert {name for name in before if not torch.equal(before[name], after[name])} == {"cycle", "latent"}


def test_each_player_is_taught_by_its_own_losses(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilAlignment(policy, discriminator_hidden=8, discriminator_layers=1)
    begin(phase, data, monkeypatch)
    parts = phase.losses(first_batch(data, phase.batch_spec))
    of_discriminators = {"discriminator", "penalty"}
    for name, loss in parts.items():
        assert (gradients(loss, phase.discriminators) > 0) == (name in of_discriminators), name
        assert (gradients(loss, policy.translator) > 0) == (name not in of_discriminators), name


def test_weights_scale_their_terms(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    plain = CdilAlignment(policy, CdilWeights(1.0, 1.0, 1.0, 1.0, 1.0), noise=0.0)
    torch.manual_seed(0)
    heavy = CdilAlignment(policy, CdilWeights(2.0, 3.0, 5.0, 7.0, 11.0), noise=0.0)
    begin(plain, data, monkeypatch)
    begin(heavy, data, monkeypatch)
    batch = first_batch(data, plain.batch_spec)
    ratios = {name: heavy.losses(batch)[name] / value for name, value in plain.losses(batch).items()}
    expected = {"adversarial": 2.0, "cycle": 3.0, "latent": 5.0, "position": 7.0, "penalty": 11.0, "discriminator": 1.0}
    assert {name: pytest.approx(value.item()) for name, value in ratios.items()} == expected


def test_discriminators_see_all_pairs_through_noise(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Tensor] = []

    def forward(network: TaskNetwork, x: Tensor, task: Tensor) -> Tensor:
        seen.append(x)
        return x[:, :1]

    monkeypatch.setattr(TaskNetwork, "forward", forward)
    sharp, blurred = (CdilAlignment(policy, noise=noise) for noise in (0.0, 0.5))
    begin(sharp, data, monkeypatch)
    begin(blurred, data, monkeypatch)
    batch = first_batch(data, sharp.batch_spec)
    sharp.losses(batch)
    count = len(seen)
    blurred.losses(batch)
    added = [(b - a).detach() for a, b in zip(seen[:count], seen[count:], strict=True)]
    by_width: dict[int, Tensor] = {}
    for difference in added:
        width = difference.shape[1]
        by_width[width] = torch.cat([by_width.get(width, difference[:0]), difference])
    assert {width: round(float(x.std()), 1) for width, x in by_width.items()} == {3: 0.0, 5: 0.0, 6: 0.5, 10: 0.5}
    assert all(abs(float(x.mean())) < 0.05 for x in by_width.values())


@pytest.mark.parametrize(
    ("epoch", "slowdown", "share"),
    [(0, 0.5, 1.0), (5, 0.5, 1.0), (6, 0.5, 0.8), (9, 0.5, 0.2), (9, 0.0, 1.0), (9, 1.0, 0.1)],
)
def test_rates_fall_in_a_line_that_meets_0_after_the_last_epoch(epoch: int, slowdown: float, share: float) -> None:
    assert slowed(epoch, 10, slowdown) == pytest.approx(share)


def test_a_share_above_1_is_refused() -> None:
    wanted = r"alignment\.lr_scheduler\.share is 1\.5; expected a share from 0 to 1; change it"
    with pytest.raises(ConfigError, match=wanted):
        parse([*SMOKE, *OVERLAY, "--alignment.lr_scheduler.share", "1.5"])


def test_one_optimiser_holds_both_players_with_a_rate_of_each(policy: CdilPolicy) -> None:
    phase = CdilAlignment(policy, discriminator_lr=0.25, optimizer=tiny.adamw(0.5, 0.125, 0.5))
    optimizer = phase.optimizer(phase.parameter_groups())
    groups = optimizer.param_groups
    held = [{id(p) for p in group["params"]} for group in groups]
    assert held == [{id(p) for p in part.parameters()} for part in (policy.translator, phase.discriminators)]
    assert [(g["lr"], g["weight_decay"], g["betas"]) for g in groups] == [(x, 0.125, (0.5, 0.999)) for x in (0.5, 0.25)]


def test_the_target_clone_learns_translated_steps_of_the_target_task_and_own_steps_of_proxies(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilAdaptation(policy)
    begin(phase, data, monkeypatch)
    batch, dataset = first_batch(data, phase.batch_spec), data.datasets["flat"]
    errors = []
    for row, task in zip(*(x.tolist() for x in (batch.steps["flat"].row, batch.steps["flat"].task)), strict=True):
        if task == policy.tasks[tiny.TARGET]:
            seen = dataset.observation.state[[row, int(dataset.next_row[row])]]
            pair = policy.translate(policy.perception.scaler(seen, "flat"))
            clone = policy.clone(pair[:1], torch.tensor([task]), "target")
            errors.append((clone - policy.infer(pair[:1], pair[1:])).square().mean().item())
    own = batch.steps["tall"]
    clone = policy.predict_actions({"tall": own.observation}, {"tall": own.task})["tall"]
    errors += (clone - own.action).square().mean(1).tolist()
    assert phase.losses(batch)["bc_target"].item() == pytest.approx(float(np.mean(errors)), rel=1e-4)


def test_the_source_clone_learns_the_sources_own_actions(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilAdaptation(policy)
    begin(phase, data, monkeypatch)
    batch = first_batch(data, phase.batch_spec)
    steps = batch.steps["flat"]
    clone = policy.predict_actions({"flat": steps.observation}, {"flat": steps.task})["flat"]
    parts = phase.losses(batch)
    torch.testing.assert_close(parts["bc_source"], (clone - steps.action).square().mean())
    assert gradients(parts["bc_source"], policy.clones["target"]) == 0
    assert gradients(parts["bc_target"], policy.clones["source"]) == 0


def test_batches_of_one_domain_alone_are_no_obstacle(
    data: TransferDataModule, policy: CdilPolicy, monkeypatch: pytest.MonkeyPatch
) -> None:
    phase = CdilAdaptation(policy)
    begin(phase, data, monkeypatch)
    parts = first_batch(data, phase.batch_spec).steps
    assert set(phase.losses(Batch({"tall": parts["tall"]}, {}))) == {"bc_target"}
    assert set(phase.losses(Batch({"flat": parts["flat"]}, {}))) == {"bc_target", "bc_source"}


def test_feature_points_learn_from_images_alone_and_are_frozen_afterwards(
    seen_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = seen.data_module(seen_file)
    policy = CdilPolicy(data.problem, latent=8, hidden=16, policy_layers=1, image_channels=[4, 3])
    phase = CdilPositions(policy)
    parts = phase.losses(first_batch(data, phase.batch_spec))
    assert set(parts) == {"position", "reconstruction"}
    for name, loss in parts.items():
        assert (gradients(loss, policy.positions) > 0) == (name == "position")
        assert (gradients(loss, policy.perception) > 0) == (name == "reconstruction")
    later = CdilAlignment(policy)
    begin(later, data, monkeypatch)
    batch = first_batch(data, later.batch_spec)
    assert all(steps.observation.images == {} for steps in batch.steps.values())
    assert gradients(torch.stack([*later.losses(batch).values()]).sum(), policy.perception) == 0
    assert "perception" in later.frozen
