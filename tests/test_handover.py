"""Weights that a phase hands on: an average over its steps, the best epoch, and both exactly after an interruption."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch
from command import METHODS, checkpoint, dies, plp, same, smoke_run, tiny_smoke
from lightning.pytorch import Callback, LightningModule, Trainer
from test_resume import ALL, EVALUATION, PHASES, STEP, assert_same_run

import plp_lightning
from datamodules.batches.loader import FixedPairs
from datamodules.types import BatchSpec
from plp_lightning.callbacks.averaging import AveragedWeights
from plp_lightning.callbacks.checkpointing import read_checkpoint
from plp_lightning.callbacks.proxy_loss import ProxyLoss
from plp_lightning.methods.plp import Alignment
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows
from plp_lightning.runs.records import file_hash

KIT = [*ALL, "--handover.average_over", "0.3", "--handover.epoch", "best"]
OVERLAYS = {path.stem: path for path in METHODS}
KINDS = ("plp_t_disc", "plp_t_noaction", "bc", "gama", "cdil", "contextual")


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("unbroken")
    answer = plp("fit", *tiny_smoke(root), *KIT)
    assert answer.code == 0, answer
    return smoke_run(root)


@pytest.mark.parametrize(
    ("where", "nth", "number"),
    [
        (STEP, 8, signal.SIGKILL),
        (STEP, 3, signal.SIGTERM),
        (STEP, 14, signal.SIGTERM),
        (EVALUATION, 1, signal.SIGKILL),
        (EVALUATION, 2, signal.SIGTERM),
    ],
)
def test_a_broken_run_comes_to_the_same_average_and_epoch(
    where: str, nth: int, number: int, tmp_path: Path, unbroken: RunDirectory
) -> None:
    assert dies(["fit", *tiny_smoke(tmp_path), *KIT], where, nth, number) in (-signal.SIGKILL, 128 + signal.SIGTERM)
    run = smoke_run(tmp_path)
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert_same_run(run, unbroken)
    for phase in PHASES:
        assert same(checkpoint(run, phase)["raw_weights"], checkpoint(unbroken, phase)["raw_weights"])
        assert checkpoint(run, phase, "best")["epoch"] == checkpoint(unbroken, phase, "best")["epoch"]


def test_training_goes_on_from_raw_weights_and_discriminators_are_not_averaged(tmp_path: Path) -> None:
    """Averaging changes nothing but what is handed on."""
    only = ["--phase", "alignment"]
    assert plp("fit", *tiny_smoke(tmp_path / "plain"), *ALL, *only).code == 0
    assert plp("fit", *tiny_smoke(tmp_path / "kit"), *KIT, *only).code == 0
    plain, kit = (checkpoint(smoke_run(tmp_path / name), "alignment") for name in ("plain", "kit"))
    assert same(kit["optimizer_states"], plain["optimizer_states"])
    assert same(kit["state_dict"] | kit["raw_weights"], plain["state_dict"])
    apart = {name for name, own in plain["state_dict"].items() if not torch.equal(own, kit["state_dict"][name])}
    assert apart <= kit["raw_weights"].keys()
    assert {name.split(".")[1] for name in apart if name.startswith("policy")} >= {"encoder", "common", "decoder"}
    assert any("discriminator" in name for name in plain["state_dict"])
    assert not any("discriminator" in name for name in kit["raw_weights"])
    assert not {"raw_weights", "averaged_steps"} & plain.keys()


class Witness(Callback):
    """Keeps the weights of each step, and those that validation and the end of each epoch see."""

    def __init__(self) -> None:
        self.raw: list[torch.Tensor] = []
        self.taken: list[int] = []
        self.seen: list[tuple[int, torch.Tensor]] = []

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: object, batch: object, batch_idx: int
    ) -> None:
        self.raw.append(_weight(pl_module).double())
        self.taken.append(trainer.global_step)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.seen.append((len(self.raw), _weight(pl_module).double()))

    on_validation_end = on_train_epoch_end = on_train_end = on_validation_start


def _weight(phase: LightningModule) -> torch.Tensor:
    assert isinstance(phase, Alignment)
    return phase.policy.common.net[0].weight.detach().clone()


@pytest.mark.parametrize(("over", "gathered"), [(0.25, 1), (1.0, 1), (0.5, 2), (0.0, 1)])
def test_who_looks_sees_the_average_that_a_slow_loop_comes_to(
    over: float, gathered: int, trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data, witness = tiny.data_module(trajectory_file), Witness()
    trainer = make_trainer(AveragedWeights(over), witness, epochs=3)
    trainer.accumulate_grad_batches, trainer.val_check_interval = gathered, 2
    trainer.fit(Alignment(tiny.policy(data), tiny.terms("mmd")), datamodule=data)
    span = max(1, round(over * int(trainer.estimated_stepping_batches)))
    averages, average, steps = [], torch.zeros_like(witness.raw[0]), 0
    for raw, taken in zip(witness.raw, witness.taken, strict=True):
        if taken > steps:  # a step of the optimizer, for which gradients may be gathered over several batches
            steps += 1
            average = average + (raw - average) / min(steps, span)
        averages.append(average)
    assert steps == int(trainer.estimated_stepping_batches)
    assert len(witness.seen) > 6
    for count, seen in witness.seen:
        if count >= gathered:
            torch.testing.assert_close(seen, averages[count - 1], rtol=1e-5, atol=1e-7)
            alone = span == 1 or witness.taken[count - 1] == 1
            assert torch.equal(seen, witness.raw[count - 1]) == alone


@pytest.mark.parametrize("method", KINDS)
def test_every_phase_of_every_method_hands_on_an_average_and_its_best_epoch(method: str, tmp_path: Path) -> None:
    words = ["--config", str(OVERLAYS[method]), "--handover.average_over", "0.3", "--handover.epoch", "best"]
    answer = plp("fit", *tiny_smoke(tmp_path), *words, "--trainer.max_epochs", "2")
    assert (answer.code, answer.err) == (0, "")
    run = smoke_run(tmp_path, method)
    for phase in run.done_phases():
        best = read_checkpoint(run.checkpoint(phase, "best"))
        losses = [float(row[2]) for row in read_rows(run.phase(phase) / "metrics.csv") if row[1] == "val/proxy"]
        assert best["epoch"] == losses.index(min(losses))
        assert best["raw_weights"]
        assert run.handed_on(phase) == run.checkpoint(phase, "best")


def test_what_comes_after_a_phase_has_its_best_epoch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProxyLoss, "_mean", lambda self, trainer, phase: float(trainer.current_epoch))
    assert plp("fit", *tiny_smoke(tmp_path), *KIT).code == 0
    run = smoke_run(tmp_path)
    for phase in PHASES:
        first, last = (checkpoint(run, phase, which) for which in ("best", "last"))
        assert (first["epoch"], last["epoch"]) == (0, 1)
        assert not same(first["state_dict"], last["state_dict"])
        chosen, other = (plp_lightning.load_policy(run.path, phase, which).state_dict() for which in (None, "last"))
        assert same(chosen, {n.removeprefix("policy."): x for n, x in first["state_dict"].items() if "policy." in n})
        assert not same(chosen, other)
    assert run.phase_record("adaptation")["from_sha256"] == file_hash(run.checkpoint("alignment", "best"))
    assert plp("export", run.path, "--to", "safetensors").code == 0
    card = json.loads((run.path / "policy.safetensors.json").read_text())
    assert card["provenance"]["checkpoint"] == "adaptation/checkpoints/best.ckpt"
    results = json.loads(run.results.read_text())
    assert plp("test", run.path).code == 0
    again = json.loads((run.path / "test.json").read_text())
    assert again["trials"]["target"]["success"] == results["target"]["success"]


@pytest.mark.parametrize("steps", ["proxy_tasks", "mix", "all"])
def test_proxy_tasks_that_are_held_out_in_the_target_domain_decide_and_nothing_else(
    steps: str, trajectory_file: Path
) -> None:
    data = tiny.data_module(trajectory_file)
    batches = [*data.held_out_proxies(BatchSpec(steps))]
    rows = torch.cat([batch.steps["tall"].row for batch in batches]).tolist()
    tasks = torch.cat([batch.steps["tall"].task for batch in batches])
    assert all(batch.steps.keys() == {"tall"} and not batch.pairs for batch in batches)
    assert sorted(rows) == sorted(data.rows(data.proxy_tasks, "val")["tall"].tolist())
    assert not {*rows} & {*data.rows(data.proxy_tasks, "train")["tall"].tolist()}
    assert data.tasks.index(tiny.TARGET) not in tasks.tolist()


def test_pairs_that_decide_are_of_proxy_tasks_too(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    batches = data.held_out_proxies(BatchSpec("none", pairs="whole"))
    assert isinstance(batches, FixedPairs)
    ids = dict(zip(batches.domains, np.concatenate(batches.chunks, axis=1), strict=True))
    assert sorted(ids["tall"]) == sorted(data.episodes("tall", data.proxy_tasks, "val"))
    for domain, found in ids.items():
        assert data.tasks.index(tiny.TARGET) not in data.datasets[domain].episode_task[found]
