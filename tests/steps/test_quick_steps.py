"""Steps without Lightning's hooks around them train, count, log and save the same as those that have them."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from command import ROOT, dies, plp, same, smoke_run, tiny_smoke, trained
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor

from datamodules.types import Batch
from plp_lightning.methods.plp import Alignment
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.steps import loop

SMALL = ["--data.batch_size", "16", "--trainer.log_every_n_steps", "7", "--trainer.accelerator", "cpu"]
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"
QUICK = "plp_lightning.steps.loop:QuickLoop._advance_quickly"
SETTINGS = {
    "plain": [],
    "schedules": ["--alignment.lr_scheduler", "CosineDecay", "--adaptation.lr_scheduler", "LinearDecay"],
    "clipped": ["--trainer.gradient_clip_val", "0.1"],
    "half precision": ["--trainer.precision", "bf16-mixed"],
    "few steps": ["--trainer.max_steps", "20"],
    "validated often": ["--trainer.val_check_interval", "5"],
    "accumulated": ["--trainer.accumulate_grad_batches", "2"],
    "all terms": ["--alignment.terms.tcc", "TCC", "--alignment.terms.adversarial", "DomainAdversarial"],
}
# A run that ends before its first validation has no best.
pytestmark = pytest.mark.filterwarnings("ignore:.*could not find the monitored key")
HURRIED = {name for name in SETTINGS if name != "accumulated"}


def run(folder: Path, *options: str, method: str = "plp") -> RunDirectory:
    overlay = ["--config", str(ROOT / "configs" / "methods" / f"{method}.yaml")]
    answer = plp("fit", *tiny_smoke(folder), *SMALL, *overlay, *options)
    assert answer.code == 0, answer
    return smoke_run(folder, method)


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the steps that were taken without hooks."""
    taken, original = list[int](), loop.QuickLoop._advance_quickly

    def noted(self: loop.QuickLoop, fetcher: Any) -> None:
        taken.append(self.global_step)
        original(self, fetcher)

    monkeypatch.setattr(loop.QuickLoop, "_advance_quickly", noted)
    return taken


def slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves Lightning's own loop in its place."""
    monkeypatch.setattr("plp_lightning.runs.trainer.step_quickly", lambda *_, **__: None)


@pytest.mark.parametrize("settings", SETTINGS)
def test_a_run_is_the_same_bit_for_bit(
    settings: str, tmp_path: Path, hurried: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = trained(run(tmp_path / "quick", *SETTINGS[settings]))
    assert bool(hurried) == (settings in HURRIED)
    slowly(monkeypatch)
    assert same(quick, trained(run(tmp_path / "slow", *SETTINGS[settings])))


@pytest.mark.parametrize("method", ["gama", "cdil", "contextual", "bc", "plp_t"])
def test_a_run_of_another_method_is_the_same_bit_for_bit(
    method: str, tmp_path: Path, hurried: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = ["--data.pairs", "1", "--trainer.max_epochs", "2"]
    quick = trained(run(tmp_path / "quick", *few, method=method))
    assert hurried
    slowly(monkeypatch)
    assert same(quick, trained(run(tmp_path / "slow", *few, method=method)))


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return run(tmp_path_factory.mktemp("unbroken"), *SETTINGS["schedules"])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize(("where", "nth"), [(STEP, 11), (QUICK, 9), (QUICK, 36)])
def test_a_run_that_ends_in_a_quick_step_resumes_exactly(
    where: str, nth: int, number: int, tmp_path: Path, unbroken: RunDirectory
) -> None:
    code = dies(["fit", *tiny_smoke(tmp_path), *SMALL, *SETTINGS["schedules"]], where, nth, number)
    assert code in (128 + number, -number)
    broken = smoke_run(tmp_path)
    answer = plp("fit", "--resume", broken.path)
    assert answer.code == 0, answer
    assert same(trained(broken), trained(unbroken))


class Counting(Callback):
    """Looks at every step."""

    def __init__(self) -> None:
        self.seen = 0

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        self.seen += 1


def test_a_callback_of_another_project_sees_every_step(tmp_path: Path, hurried: list[int]) -> None:
    overlay = tmp_path / "counting.yaml"
    overlay.write_text("callbacks: [{class_path: test_quick_steps.Counting}]\n")
    run(tmp_path, "--config", str(overlay), "--allow_imports", "test_quick_steps")
    assert hurried == []


def test_a_phase_that_logs_in_every_step_is_heard(
    tmp_path: Path, hurried: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Alignment.training_step

    def logging(self: Alignment, batch: Batch, batch_idx: int) -> Tensor:
        loss = original(self, batch, batch_idx)
        self.log("train/mean", loss.detach(), on_step=False, on_epoch=True, batch_size=1)
        return loss

    monkeypatch.setattr(Alignment, "training_step", logging)
    rows = trained(run(tmp_path, "--phase", "alignment"))["alignment"][-1]
    assert [row[1] for row in rows].count("train/mean") == 2  # one for each epoch
    assert hurried == []
