"""Steps as graphs, on a stand-in that takes a recorded step anew: weights, counts and curves stay as they are.

What only a GPU can show, ``script/bench gpu_weights --device cuda`` shows there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from command import ROOT, plp, same, smoke_run, tiny_smoke, trained
from torch import Tensor

from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.steps import capture
from plp_lightning.stopping import PreemptedError

SMALL = ["--data.batch_size", "16", "--trainer.log_every_n_steps", "7", "--trainer.accelerator", "cpu"]
GRAPHS = [*SMALL, "--cuda_graphs", "true"]


class Rerun:
    """Takes a recorded step anew, and puts its loss where the recording has it."""

    replays = 0

    def __init__(self, step: Callable[[], Tensor], loss: Tensor) -> None:
        self.step, self.loss = step, loss

    def replay(self) -> None:
        Rerun.replays += 1
        self.loss.copy_(self.step())


def recorded(step: Callable[[], Tensor]) -> tuple[Rerun, Tensor]:
    loss = torch.zeros(())
    return Rerun(step, loss), loss


def rehearsed(step: Callable[[], Tensor]) -> None:
    with torch.random.fork_rng():
        for _ in range(capture.REHEARSALS):
            step()


def on_fixed_tables(data: TransferDataModule, batch_spec: BatchSpec) -> Any:
    return data.fixed_loader(batch_spec, torch.device("cpu"))


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables that lie on a device, and graphs, without a GPU."""
    monkeypatch.setattr(Rerun, "replays", 0)
    monkeypatch.setattr(TransferDataModule, "_phase_loader", on_fixed_tables)
    monkeypatch.setattr(capture, "recorded", recorded)
    monkeypatch.setattr(capture, "_capturable", lambda *_: contextlib.nullcontext())
    monkeypatch.setattr(capture, "rehearsed", rehearsed)


def run(folder: Path, *options: str, method: str = "plp") -> RunDirectory:
    overlay = ["--config", str(ROOT / "configs" / "methods" / f"{method}.yaml")]
    answer = plp("fit", *tiny_smoke(folder), *GRAPHS, *overlay, *options)
    assert answer.code == 0, answer
    return smoke_run(folder, method)


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize("method", ["plp", "plp_t", "plp_disc", "gama", "bc", "contextual"])
def test_a_run_of_graphs_is_that_of_single_steps(method: str, tmp_path: Path) -> None:
    few = ["--trainer.max_epochs", "2", "--data.epoch_steps", "30"]
    graphs = run(tmp_path / "graphs", *few, method=method)
    steps = Rerun.replays
    assert steps > 50
    single = run(tmp_path / "single", *few, "--cuda_graphs", "false", method=method)
    assert Rerun.replays == steps
    assert same(trained(graphs), trained(single))


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize("handover", [[], ["--handover.average_over", "0.3", "--handover.epoch", "best"]])
def test_a_run_of_graphs_resumes_exactly(handover: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schedules = ["--alignment.lr_scheduler", "CosineDecay", "--adaptation.lr_scheduler", "CosineDecay", *handover]
    single = run(tmp_path / "single", "--cuda_graphs", "false", *schedules)
    unbroken = run(tmp_path / "unbroken", *schedules)
    noticed, original = [], Preemption.on_train_batch_end

    def stopped(self: Preemption, *words: Any) -> None:
        noticed.append(words)
        self.received = 15 if len(noticed) == 30 else self.received
        original(self, *words)

    with monkeypatch.context() as patch:
        patch.setattr(Preemption, "on_train_batch_end", stopped)
        answer = plp("fit", *tiny_smoke(tmp_path / "broken"), *GRAPHS, *schedules)
        assert answer.code == PreemptedError(15).exit_code, answer
    broken = smoke_run(tmp_path / "broken")
    assert plp("fit", "--resume", broken.path).code == 0
    assert same(trained(broken), trained(unbroken))
    assert same(trained(single), trained(unbroken))


@pytest.mark.usefixtures("stand_in")
def test_a_step_that_cannot_be_captured_is_taken_piece_by_piece(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(step: Callable[[], Tensor]) -> tuple[Rerun, Tensor]:
        raise capture.CaptureError("operation not permitted when stream is capturing")

    single = run(tmp_path / "single", "--cuda_graphs", "false")
    monkeypatch.setattr(capture, "recorded", refused)
    answer = plp("fit", *tiny_smoke(tmp_path / "refused"), *GRAPHS)
    assert answer.code == 0, answer
    told = "its steps are launched piece by piece, not as CUDA graphs: operation not permitted"
    assert [line.partition(told)[0] for line in answer.err.splitlines()] == ["plp: Alignment: ", "plp: Adaptation: "]
    assert same(trained(smoke_run(tmp_path / "refused")), trained(single))


@pytest.mark.usefixtures("stand_in")
@pytest.mark.parametrize(
    ("option", "told"),
    [
        (["--alignment.optimizer", "torch.optim.SGD"], "its optimizer is none of Adam's family"),
        (["--trainer.profiler", "simple"], "callbacks, hooks or a profiler look into steps"),
        (["--trainer.detect_anomaly", "true"], "anomalies are looked for"),
    ],
)
def test_what_keeps_steps_from_being_graphs_is_told_once(option: list[str], told: str, tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), *GRAPHS, *option)
    assert answer.code == 0, answer
    lines = [line for line in answer.err.splitlines() if line.startswith("plp: Alignment: ")]
    assert [line.rpartition("graphs: ")[2] for line in lines] == [told]
