from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor
from torch.nn import functional

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.methods.gama.phases import GamaAdaptation, GamaAlignment, GamaPhase, GamaPretraining
from plp_lightning.methods.gama.policy import GamaPolicy
from plp_lightning.methods.phase import Phase


class Recorded(Phase[GamaPolicy]):
    """Keeps the parts of a step instead of logging them."""

    logs_now = True  # type: ignore[assignment]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        self.parts = parts


class WatchedPretraining(Recorded, GamaPretraining): ...


class WatchedAlignment(Recorded, GamaAlignment): ...


class WatchedAdaptation(Recorded, GamaAdaptation): ...


def policy_of(data: TransferDataModule) -> GamaPolicy:
    torch.manual_seed(0)
    return GamaPolicy(data.problem, hidden=16, policy_layers=1, map_layers=1, dynamics_layers=1, image_channels=[4, 3])


def begun(phase: GamaPhase, data: TransferDataModule, make_trainer: Callable[..., Trainer]) -> Batch:
    """The first batch of a phase that knows its states."""
    trainer = make_trainer()
    trainer.datamodule = data  # type: ignore[attr-defined]
    phase.trainer = trainer
    phase.on_fit_start()
    return next(iter(data.loader(phase.batch_spec)))


def gradients(phase: Phase[GamaPolicy], loss: Tensor) -> dict[str, Tensor]:
    phase.zero_grad()
    loss.backward()
    return {name: p.grad.clone() for name, p in phase.named_parameters() if p.grad is not None}


def test_parts_of_alignment_are_the_separate_losses(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = WatchedAlignment(policy_of(data), adversarial_weight=0.3, penalty_weight=0.7, discriminator_hidden=8)
    batch = begun(phase, data, make_trainer)
    total = phase.training_step(batch, 0)
    policy, judge, steps = phase.policy, phase.discriminator, batch.steps
    source, target, datasets = steps["flat"], steps["tall"], data.datasets
    errors, real, fake, told, slopes = [], [], [], [], []
    for i in range(len(target.action)):
        state = policy.perception.scaler(target.observation.state[i : i + 1], "tall")
        action = policy.predict_actions({"tall": target.observation.take([i])}, {"tall": target.task[[i]]})["tall"]
        errors.append((action - target.action[i]).square().mean())
        moved = policy.state_map(state)
        arrived = policy.state_map(policy.dynamics(state, action))
        planned = policy.imitate(moved, target.task[[i]])
        logit = judge(judge.describe(moved, planned, arrived, target.task[[i]]))
        fake.append(functional.logsigmoid(logit))
        told.append(functional.logsigmoid(-logit))
    for i, row in enumerate(source.row.tolist()):
        rows = (row, int(datasets["flat"].next_row[row]))
        before, after = (policy.perception.scaler(datasets["flat"].observation.state[[n]], "flat") for n in rows)
        described = judge.describe(before, source.action[[i]], after, source.task[[i]])
        real.append(functional.logsigmoid(judge(described)))
        slopes.append(torch.autograd.functional.jacobian(judge, described).square().sum())
    expected = {
        "bc": torch.stack(errors).mean(),
        "adversarial": -torch.cat(fake).mean(),
        "discriminator": -torch.cat(real).mean() - torch.cat(told).mean(),
        "penalty": torch.stack(slopes).mean() / 2,
    }
    for name, value in expected.items():
        torch.testing.assert_close(phase.parts[name], value, msg=name)
    parts = phase.parts
    whole = parts["bc"] + 0.3 * parts["adversarial"] + parts["discriminator"] + 0.7 * parts["penalty"]
    torch.testing.assert_close(total, whole + parts["dynamics"])


def test_the_discriminators_unit_is_the_usual_change_of_the_source(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = WatchedAlignment(policy_of(data))
    begun(phase, data, make_trainer)
    assert torch.equal(phase.discriminator.unit, phase.usual_change("flat"))


def test_each_loss_of_alignment_reaches_its_own_player_only(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = WatchedAlignment(policy_of(data))
    batch = begun(phase, data, make_trainer)
    phase.training_step(batch, 0)
    parts = dict(phase.parts)
    players = {
        "bc": {"policy.state_map", "policy.source_policy", "policy.action_map"},
        "adversarial": {"policy.state_map", "policy.source_policy", "policy.action_map"},
        "discriminator": {"discriminator.net"},
        "penalty": {"discriminator.net"},
        "dynamics": {"policy.dynamics"},
    }
    for name in parts:
        phase.training_step(batch, 0)
        reached = {".".join(n.split(".")[:2]) for n, g in gradients(phase, phase.parts[name]).items() if g.any()}
        assert reached == players[name], name
    held = {id(p) for group in phase.optimizer(phase.parameter_groups()).param_groups for p in group["params"]}
    assert not held & {id(p) for p in phase.policy.source_policy.parameters()}


def test_players_learn_at_rates_of_their_own(trajectory_file: Path) -> None:
    phase = WatchedAlignment(
        policy_of(tiny.data_module(trajectory_file)), optimizer=tiny.adamw(1.0), discriminator_lr=2.0, dynamics_lr=3.0
    )
    groups = phase.optimizer(phase.parameter_groups()).param_groups
    parts = phase.policy.state_map, phase.discriminator, phase.policy.dynamics
    for group, part, rate in zip(groups, parts, (1.0, 2.0, 3.0), strict=True):
        assert group["lr"] == rate
        assert {id(p) for p in part.parameters()} <= {id(p) for p in group["params"]}


@pytest.mark.parametrize(
    ("kind", "changed"),
    [
        (GamaPretraining, {"source_policy", "dynamics"}),
        (GamaAlignment, {"state_map", "action_map", "dynamics"}),
        (GamaAdaptation, {"source_policy"}),
    ],
)
def test_phases_change_what_they_are_for(
    kind: type[GamaPretraining | GamaAlignment | GamaAdaptation],
    changed: set[str],
    trajectory_file: Path,
    make_trainer: Callable[..., Trainer],
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = kind(policy_of(data), optimizer=tiny.adamw(1e-3, 0.1))
    before = {name: value.clone() for name, value in phase.policy.state_dict().items()}
    make_trainer(FreezeGuard(), epochs=1).fit(phase, datamodule=data)
    now = phase.policy.state_dict()
    assert {name.split(".")[0] for name in before if not torch.equal(now[name], before[name])} == changed
    frozen = {name.split(".")[0] for name in phase.frozen}
    assert not frozen & changed
    # Without cameras there are no eyes that could learn, and the scaling is part of perception.
    assert (frozen - {"scaler"}) | changed | {"perception"} == {name for name, _ in phase.policy.named_children()}


def test_adaptation_learns_from_the_source_domain_alone_unless_told_otherwise(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    for both in (False, True):
        phase = WatchedAdaptation(policy_of(data), target_mix=both)
        steps = begun(phase, data, make_trainer).steps
        assert set(steps) == {"flat", "tall"}
        found = phase.training_step(Batch(steps, {}), 0)
        decided = phase.policy.predict_actions(
            {d: s.observation for d, s in steps.items()}, {d: s.task for d, s in steps.items()}
        )
        errors = [(decided[d] - s.action).square().mean(dim=1) for d, s in steps.items() if both or d == "flat"]
        torch.testing.assert_close(found, torch.cat(errors).mean())


def test_a_batch_without_source_steps_teaches_nothing(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = WatchedAdaptation(policy_of(data))
    steps = begun(phase, data, make_trainer).steps
    found = gradients(phase, phase.training_step(Batch({"tall": steps["tall"]}, {}), 0))
    assert {name.split(".")[1] for name in found} == {"source_policy"}
    assert not any(gradient.any() for gradient in found.values())


@pytest.mark.parametrize("kind", [GamaPretraining, GamaAlignment, GamaAdaptation])
def test_phases_refuse_other_policies(kind: type[Phase[GamaPolicy]], trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    with pytest.raises(ConfigError, match=f"phase {kind.__name__} trains a GamaPolicy, found a PortablePolicy"):
        kind(policy)  # type: ignore[call-arg,arg-type]


def test_eyes_learn_from_reconstruction_alone(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    phase = WatchedPretraining(policy_of(data))
    batch = next(iter(data.loader(phase.batch_spec)))
    phase.training_step(batch, 0)
    reached = {
        "bc": {"policy.source_policy"},
        "dynamics": {"policy.dynamics"},
        "reconstruction": {"policy.perception", "redrawing.decoders"},
    }
    assert set(phase.parts) == set(reached)
    for name, players in reached.items():
        phase.training_step(batch, 0)
        found = gradients(phase, phase.parts[name])
        assert {".".join(n.split(".")[:2]) for n, gradient in found.items() if gradient.any()} == players, name


def test_states_that_are_looked_up_are_those_that_are_perceived(
    seen_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = seen.data_module(seen_file)
    phase = WatchedAdaptation(policy_of(data), target_mix=True)
    steps = begun(phase, data, make_trainer).steps
    with_images = {d: data.datasets[d].take(s.row) for d, s in steps.items()}
    decided = phase.policy.predict_actions(
        {d: s.observation for d, s in with_images.items()}, {d: s.task for d, s in steps.items()}
    )
    for domain, action in phase.predict(steps).items():
        torch.testing.assert_close(action, decided[domain])
