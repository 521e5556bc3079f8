"""Data that do not say what was seen last: methods that look a step ahead leave last steps out, and lose nothing else.

Before, batches held last steps as well, and losses were given masks that made them count for nothing. Here those losses
are computed the old way, a step at a time, in float64, from batches to which all last steps were added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import seen
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.transfer import TransferDataModule
from datamodules.types import Batch, Steps
from plp_lightning.methods import (
    CdilAdaptation,
    CdilAlignment,
    CdilDynamics,
    CdilPolicy,
    CdilPositions,
    GamaAdaptation,
    GamaAlignment,
    GamaPolicy,
    GamaPretraining,
    Phase,
)
from plp_lightning.methods.state_only.phases import StateOnlyAdaptation, StateOnlyAlignment, StateOnlyPolicy
from plp_lightning.networks import ImageEncoding

SMALL = {"hidden": 8, "policy_layers": 1, "image_channels": [4, 3]}


def gama(data: TransferDataModule) -> list[Phase]:
    policy = GamaPolicy(data.problem, map_layers=1, dynamics_layers=1, **SMALL)  # type: ignore[arg-type]
    return [GamaPretraining(policy), GamaAlignment(policy), GamaAdaptation(policy)]


def cdil(data: TransferDataModule) -> list[Phase]:
    policy = CdilPolicy(data.problem, latent=4, translator_encoder_layers=1, translator_decoder_layers=1, **SMALL)  # type: ignore[arg-type]
    return [CdilPositions(policy), CdilAlignment(policy), CdilDynamics(policy), CdilAdaptation(policy)]


def state_only(data: TransferDataModule) -> list[Phase]:
    policy = StateOnlyPolicy(
        data.problem, latent=4, hidden=8, decoder_state="all", image_encoder=ImageEncoding((4, 6), 5)
    )
    return [StateOnlyAlignment(policy, tiny.terms("mmd", "tcc")), StateOnlyAdaptation(policy)]


METHODS = pytest.mark.parametrize("method", [gama, cdil, state_only], ids=lambda method: method.__name__)


@pytest.fixture
def data(format_1_0: Path) -> TransferDataModule:
    torch.manual_seed(0)
    return seen.data_module(format_1_0, trajectories=8)


@METHODS
def test_every_phase_trains_on_data_without_last_observations(
    method: Callable[[TransferDataModule], list[Phase]], data: TransferDataModule, make_trainer: Callable[..., Trainer]
) -> None:
    for phase in method(data):
        before = {name: value.clone() for name, value in phase.policy.state_dict().items()}
        trainer = make_trainer(epochs=1)
        trainer.fit(phase, datamodule=data)
        assert trainer.callback_metrics[phase.monitor].isfinite()
        after = phase.policy.state_dict()
        assert all(torch.equal(value.isfinite(), before[name].isfinite()) for name, value in after.items())
        assert any(not torch.equal(value, before[name]) for name, value in after.items())


@METHODS
def test_phases_that_look_ahead_are_given_all_steps_but_the_last_ones(
    method: Callable[[TransferDataModule], list[Phase]], data: TransferDataModule
) -> None:
    looking_ahead = [phase for phase in method(data) if phase.batch_spec.next_observation]
    assert looking_ahead
    for phase in looking_ahead:
        rows: dict[str, set[int]] = {}
        loader = data.loader(phase.batch_spec)
        for _ in range(30):
            for batch in loader:
                for domain, steps in batch.steps.items():
                    rows.setdefault(domain, set()).update(steps.row.tolist())
        given = data.rows(data.tasks if phase.batch_spec.steps == "all" else data.proxy_tasks, "train")
        for domain, dataset in data.datasets.items():
            ends = {stop - 1 for stop in dataset.offset[1:].tolist()}
            assert not rows[domain] & ends
            assert rows[domain] >= {*given[domain].tolist()} - ends


# -- losses ------------------------------------------------------------------------------------------


@pytest.fixture
def doubled(data: TransferDataModule) -> TransferDataModule:
    """Without images, in float64."""
    for domain, dataset in data.datasets.items():
        blind = dataset.without_images()
        exact = replace(blind.observation, state=blind.observation.state.double())
        data.datasets[domain] = replace(blind, observation=exact, action=blind.action.double())
    return data


def begun(phase: Phase, data: TransferDataModule, make_trainer: Callable[..., Trainer]) -> Batch:
    """The first batch of a phase in float64."""
    phase.double()
    phase.trainer = make_trainer()
    phase.trainer.datamodule = data  # type: ignore[attr-defined]
    phase.on_fit_start()
    return next(iter(data.loader(phase.batch_spec)))


def with_last_steps(data: TransferDataModule, domain: str, steps: Steps) -> list[tuple[int, int, bool]]:
    """Each step's row and the row after it, and whether the step is a last one, which then comes again."""
    ends = data.datasets[domain].offset[1:] - 1
    rows = np.concatenate([steps.row.numpy(), ends])
    return [(row, row + (row not in ends), row in ends) for row in rows.tolist()]


def masked_mean(values: list[float], last: list[bool]) -> float:
    return sum(v for v, ends in zip(values, last, strict=True) if not ends) / last.count(False)


@torch.no_grad()
def test_gamas_losses_are_those_with_masks(
    doubled: TransferDataModule, make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = GamaPolicy(doubled.problem, hidden=8, policy_layers=1, map_layers=1, dynamics_layers=1, image_channels=())
    phase, parts = GamaAlignment(policy, discriminator_hidden=8), dict[str, Tensor]()
    monkeypatch.setattr(GamaAlignment, "logs_now", True)
    monkeypatch.setattr(phase, "log_parts", lambda found, size: parts.update(found))
    batch, judge = begun(phase, doubled, make_trainer), phase.discriminator
    with torch.enable_grad():
        phase.training_step(batch, 0)
    rows = {domain: with_last_steps(doubled, domain, steps) for domain, steps in batch.steps.items()}
    last = {domain: [ends for _, _, ends in found] for domain, found in rows.items()}
    real, fooled, told, errors, changes = [], [], [], [], []
    left, right = (doubled.datasets[domain] for domain in ("left", "right"))
    scale = policy.perception.scaler
    for row, following, _ in rows["left"]:
        now, then = (scale(left.observation.state[[n]], "left") for n in (row, following))
        real.append(judge(judge.describe(now, left.action[[row]], then, left.task[[row]])).sigmoid().log().item())
    for row, following, _ in rows["right"]:
        now, then = (scale(right.observation.state[[n]], "right") for n in (row, following))
        moved = policy.state_map(now)
        planned = policy.imitate(moved, right.task[[row]])
        arrived = policy.state_map(policy.dynamics(now, policy.translate(planned, now)))
        chance = judge(judge.describe(moved, planned, arrived, right.task[[row]])).sigmoid()
        fooled.append(chance.log().item())
        told.append((1 - chance).log().item())
        errors.append((policy.dynamics(now, right.action[[row]]) - then).square()[0].tolist())
        changes.append((then - now).square()[0].tolist())
    columns = zip(zip(*errors, strict=True), zip(*changes, strict=True), strict=True)
    shares = [masked_mean([*e], last["right"]) / masked_mean([*c], last["right"]) for e, c in columns]
    expected = {
        "adversarial": -masked_mean(fooled, last["right"]),
        "discriminator": -masked_mean(real, last["left"]) - masked_mean(told, last["right"]),
        "dynamics": sum(shares) / len(shares),
    }
    assert {name: parts[name].item() for name in expected} == pytest.approx(expected, rel=1e-9)


@torch.no_grad()
def test_cdils_inverse_dynamics_lose_what_they_lost_with_masks(
    doubled: TransferDataModule, make_trainer: Callable[..., Trainer]
) -> None:
    policy = CdilPolicy(doubled.problem, hidden=8, policy_layers=1, image_channels=())
    phase = CdilDynamics(policy)
    batch, dataset = begun(phase, doubled, make_trainer), doubled.datasets["right"]
    rows = with_last_steps(doubled, "right", batch.steps["right"])
    errors = []
    for row, following, _ in rows:
        now, then = (policy.perception.scaler(dataset.observation.state[[n]], "right") for n in (row, following))
        errors.append((policy.infer(now, then) - dataset.action[[row]]).square().mean().item())
    expected = masked_mean(errors, [ends for _, _, ends in rows])
    assert phase.losses(batch)["inverse_dynamics"].item() == pytest.approx(expected, rel=1e-9)


@torch.no_grad()
def test_predictions_of_the_next_latent_state_lose_what_they_lost_with_masks(
    doubled: TransferDataModule, make_trainer: Callable[..., Trainer]
) -> None:
    blind = [replace(spec, observation=spec.state_keys) for spec in doubled.specs]
    policy = StateOnlyPolicy(replace(doubled.problem, domains=blind), latent=4, hidden=8, decoder_state="all")
    for phase in (StateOnlyAlignment(policy, []), StateOnlyAdaptation(policy)):
        batch = begun(phase, doubled, make_trainer)
        foreseen, inferred, last = [], [], {domain: [] for domain in batch.steps}
        for domain, steps in batch.steps.items():
            dataset = doubled.datasets[domain]
            for row, following, ends in with_last_steps(doubled, domain, steps):
                now, then = ({domain: dataset.observation.take([n])} for n in (row, following))
                after = policy.encode(then)[domain]
                plan = policy.latent_action(policy.encode(now), {domain: dataset.task[[row]]})[domain]
                foreseen.append((plan - after).square().mean().item())
                last[domain].append(ends)
                if domain == "right":
                    action = policy.decode({domain: after}, now)[domain]
                    inferred.append((action - dataset.action[[row]]).square().mean().item())
        expected = masked_mean(foreseen, [ends for found in last.values() for ends in found])
        if isinstance(phase, StateOnlyAdaptation):
            found = {"next": phase._foresight(batch.steps).item()}
        else:
            latent = policy.encode({domain: s.observation for domain, s in batch.steps.items()})
            found = {name: loss.item() for name, loss in phase.imitation_losses(latent, batch.steps).items()}
            assert found.pop("inverse") == pytest.approx(masked_mean(inferred, last["right"]), rel=1e-9)
        assert found == {"next": pytest.approx(expected, rel=1e-9)}
