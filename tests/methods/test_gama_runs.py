"""GAMA as a whole: it finds a map that is known, and runs through the command line like any method."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch
from command import ROOT, checkpoint, dies, plp, results, same, smoke_run, tiny_smoke
from lightning.pytorch import Trainer

from datamodules.store.writer import write_trajectories
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.methods.gama.phases import GamaAdaptation, GamaAlignment, GamaPretraining
from plp_lightning.methods.gama.policy import GamaPolicy
from plp_lightning.methods.optimization import CosineDecay
from plp_lightning.runs.directory import RunDirectory

PHASES = ("pretraining", "alignment", "adaptation")
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"


def test_gama_finds_the_map_between_two_planes_and_a_new_task_along_it(
    tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(tmp_path / "many.hdf5", specs, tiny.TASKS, tiny.demonstrations(12), {"command": "tests"})
    data = tiny.data_module(tmp_path / "many.hdf5", trajectories=84, target_trajectories=12)
    torch.manual_seed(0)
    policy = GamaPolicy(data.problem, hidden=64, policy_layers=2, map_layers=2, dynamics_layers=1)
    make_trainer(epochs=6).fit(
        GamaPretraining(policy, optimizer=tiny.adamw(3e-3), lr_scheduler=CosineDecay), datamodule=data
    )
    alignment = GamaAlignment(
        policy, optimizer=tiny.adamw(3e-3), discriminator_lr=1e-3, discriminator_hidden=32, lr_scheduler=CosineDecay
    )
    make_trainer(epochs=14).fit(alignment, datamodule=data)
    policy.requires_grad_()
    make_trainer(epochs=10).fit(
        GamaAdaptation(policy, optimizer=tiny.adamw(3e-3), lr_scheduler=CosineDecay), datamodule=data
    )

    flat, tall = (domain.simulator for domain in tiny.domains().values())
    assert isinstance(flat, LinearPoint)
    assert isinstance(tall, LinearPoint)
    rows = data.rows(data.proxy_tasks, "train")["tall"]
    there = data.datasets["tall"].observation.take(torch.from_numpy(rows))
    place = tall.shared_position(there.state.numpy())
    truth = tiny.observe(place @ flat.lift.T + flat.shift)
    with torch.no_grad():
        moved = policy.encode({"tall": there})["tall"].numpy()
        wanted = policy.encode({"flat": truth})["flat"].numpy()
        taken = data.datasets["flat"].action
        turned = policy.translate(taken, torch.zeros(len(taken), 5)).numpy()
    assert np.square(moved - wanted).mean() < 0.1 * wanted.var()
    rotated = taken.numpy() @ flat.rotation @ tall.rotation.T
    assert np.square(turned - rotated).mean() < 0.15 * rotated.var()

    policy.eval()
    outcome = rollout(tall, policy.actor("tall", [tiny.TARGET] * 20), [tiny.TARGET] * 20, list(range(20)))
    assert outcome.success.mean() >= 0.9


def options(folder: Path) -> list[str]:
    gama = str(ROOT / "configs" / "methods" / "gama.yaml")
    return [*tiny_smoke(folder), "--config", gama, "--pretraining.epochs", "2"]


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("gama")
    answer = plp("fit", *options(root))
    assert answer.code == 0, answer
    assert answer.err == ""
    return smoke_run(root, "gama")


def test_it_runs_through_the_command_line_and_is_tested_again(unbroken: RunDirectory, tmp_path: Path) -> None:
    found = json.loads(unbroken.results.read_text())
    assert (found["method"], found["phases"]) == ("gama", list(PHASES))
    assert 0 <= found["alignment"]["closeness"] <= 1
    # The target's actions come from maps that pretraining leaves as they were.
    assert [bool(unbroken.phase_record(phase)["trials"]) for phase in PHASES] == [False, True, True]
    assert found["target"]["before"] == unbroken.phase_record("alignment")["trials"]["target"]["success"]
    answer = plp("test", unbroken.path, "--output", tmp_path / "test.json")
    assert answer.code == 0, answer
    assert json.loads((tmp_path / "test.json").read_text())["trials"]["target"]["episodes"] == 4


@pytest.mark.parametrize("step", [8, 20, 27])
def test_a_stopped_run_resumes_to_the_same_weights(step: int, tmp_path: Path, unbroken: RunDirectory) -> None:
    assert dies(["fit", *options(tmp_path)], STEP, step, signal.SIGTERM) == 128 + signal.SIGTERM
    run = smoke_run(tmp_path, "gama")
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    for phase in PHASES:
        ours, theirs = checkpoint(run, phase), checkpoint(unbroken, phase)
        assert same(ours["state_dict"], theirs["state_dict"]), phase
        assert same(ours["optimizer_states"], theirs["optimizer_states"]), phase
    assert results(run) == results(unbroken)
