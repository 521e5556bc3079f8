"""Two domains that are linear maps of one plane: the translation between them exists and is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.evaluation.simulation import EvalSetting, evaluate
from plp_lightning.methods import CdilAdaptation, CdilAlignment, CdilDynamics, CdilPolicy, CdilPositions, Phase
from plp_lightning.runs.trainer import quiet_lightning

Learned = tuple[CdilPolicy, TransferDataModule]


def small_policy(data: TransferDataModule) -> CdilPolicy:
    torch.manual_seed(0)
    return CdilPolicy(
        data.problem, latent=16, hidden=48, translator_encoder_layers=1, policy_layers=2, translator_decoder_layers=1
    )


def train(phase: Phase[CdilPolicy], data: TransferDataModule) -> None:
    quiet_lightning()
    Trainer(
        accelerator="cpu",
        max_epochs=phase.epochs,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        limit_val_batches=0,
    ).fit(phase, datamodule=data)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> TransferDataModule:
    path = tmp_path_factory.mktemp("cdil") / "synthetic.hdf5"
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(path, specs, tiny.TASKS, tiny.demonstrations(12), {"command": "tests"})
    return tiny.data_module(path, trajectories=84, target_trajectories=12, val_fraction=0.1, batch_size=256)


@pytest.fixture(scope="module")
def learned(data: TransferDataModule) -> CdilPolicy:
    policy = small_policy(data)
    train(CdilPositions(policy, epochs=15, optimizer=tiny.adamw(5e-3)), data)
    players = tiny.adamw(3e-3, first_moment=0.5)
    train(CdilAlignment(policy, epochs=30, optimizer=players, discriminator_hidden=48, discriminator_layers=2), data)
    train(CdilDynamics(policy, epochs=15, optimizer=tiny.adamw(5e-3)), data)
    train(CdilAdaptation(policy, epochs=80, optimizer=tiny.adamw(5e-3)), data)
    return policy.eval()


def simulator(domain: str) -> LinearPoint:
    found: Simulator = tiny.domains()[domain].simulator
    assert isinstance(found, LinearPoint)
    return found


def errors(policy: CdilPolicy, data: TransferDataModule, tasks: tuple[str, ...]) -> Tensor:
    """How far translated source states of ``tasks`` are from their true partners ``(N,)``, in deviations."""
    rows = torch.from_numpy(np.concatenate([data.rows(tasks, part)["flat"] for part in data.parts]))
    state = data.datasets["flat"].observation.state[rows].numpy()
    there = simulator("tall")
    partner = simulator("flat").shared_position(state) @ there.lift.T + there.shift
    with torch.no_grad():
        translated = policy.encode({"flat": tiny.observe(state)})["flat"]
        return (translated - policy.perception.scaler(tiny.observe(partner).state, "tall")).square().mean(1).sqrt()


@pytest.mark.parametrize("tasks", [tiny.PROXIES, (tiny.TARGET,)], ids=["proxy_tasks", "target task"])
def test_translated_states_are_near_their_true_partners(
    tasks: tuple[str, ...], learned: CdilPolicy, data: TransferDataModule
) -> None:
    assert errors(learned, data, tasks).mean() < 0.25
    assert errors(small_policy(data), data, tasks).mean() > 0.6


def test_there_and_back_is_where_it_began(learned: CdilPolicy, data: TransferDataModule) -> None:
    for domain, role in learned.roles.items():
        state = learned.perception.scaler(data.datasets[domain].observation.state, domain)
        with torch.no_grad():
            there = learned.translator(state, role)
            back = learned.translator(there.state, "target" if role == "source" else "source")
        assert (back.state - state).abs().mean() < 0.1


def test_inverse_dynamics_know_the_actions_that_were_never_learned_from(
    learned: CdilPolicy, data: TransferDataModule
) -> None:
    rows = torch.from_numpy(data.rows(data.proxy_tasks, "val")["tall"])
    steps = data.datasets["tall"].take(rows, next_observation=True)
    assert steps.next_observation is not None
    now, following = (learned.perception.scaler(x.state, "tall") for x in (steps.observation, steps.next_observation))
    with torch.no_grad():
        error = learned.infer(now, following) - steps.action
    assert error.square().mean() < 0.02
    assert steps.action.square().mean() > 0.2


def test_the_target_domain_does_a_task_that_it_was_never_shown(learned: CdilPolicy, data: TransferDataModule) -> None:
    assert tiny.TARGET not in {data.tasks[i] for i in data.datasets["tall"].episode_task}
    found = {
        d: evaluate(learned, simulator(d), EvalSetting(d, (tiny.TARGET,)), 32, 0).success for d in ("flat", "tall")
    }
    assert found["flat"] > 0.9
    assert found["tall"] > 0.8
