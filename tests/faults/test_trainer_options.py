"""Options of Lightning's Trainer and callbacks of its do what they say, or are refused before a run begins."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from command import checkpoint, complaint, dies, plp, same, smoke_run, tiny_smoke
from lightning.pytorch import Callback, LightningModule, Trainer

from datamodules.batches.loader import Loader
from datamodules.batches.orders import AlignmentOrder
from plp_lightning.methods.optimization import FusedAdamW, let_clip
from plp_lightning.runs.directory import RunDirectory


class BatchPrint(Callback):
    """Prints a number that tells batches apart."""

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        sums = [round(float(steps.action.sum()), 4) for steps in batch.steps.values()]
        print("batch", trainer.current_epoch, batch_idx, sums)


def fitted(root: Path, *words: str) -> RunDirectory:
    answer = plp("fit", *tiny_smoke(root), *words)
    assert answer.code == 0, answer
    return smoke_run(root)


def batches(root: Path, *words: str) -> list[list[str]]:
    """What :class:`BatchPrint` tells of each epoch's batches in alignment."""
    own = ["--allow_imports", "test_trainer_options", "--callbacks+=test_trainer_options.BatchPrint"]
    answer = plp("fit", *tiny_smoke(root), "--phase", "alignment", "--alignment.epochs", "4", *own, *words)
    assert answer.code == 0, answer
    lines = [line.split(maxsplit=3) for line in answer.out.splitlines() if line.startswith("batch")]
    return [[told for _, now, _, told in lines if now == str(epoch)] for epoch in range(4)]


def test_overfitted_batches_are_the_same_in_every_epoch(tmp_path: Path) -> None:
    first, *others = batches(tmp_path, "--trainer.overfit_batches", "2")
    assert len(first) == 2
    assert others == [first] * 3


def test_an_epoch_that_is_cut_short_is_followed_by_a_whole_new_one(tmp_path: Path) -> None:
    whole = batches(tmp_path / "whole")
    cut = batches(tmp_path / "cut", "--trainer.limit_train_batches", "3")
    assert len(whole[0]) > 3
    assert cut == [epoch[:3] for epoch in whole]


def test_a_loader_goes_on_in_an_epoch_that_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    order = AlignmentOrder({"a": np.arange(40)}, 8, seed=0)
    monkeypatch.setattr("datamodules.batches.loader._take", lambda dataset, rows, spec: rows.tolist())

    def loader() -> Loader:
        made = Loader({"a": None}, order)  # type: ignore[dict-item]
        made.cut(3, repeats=False)
        return made

    one, other = loader(), loader()
    unbroken = [batch.steps for _ in range(2) for batch in one]
    steps = iter(other)
    begun = [next(steps).steps for _ in range(2)]
    resumed = loader()
    resumed.load_state_dict(other.state_dict())
    assert begun + [batch.steps for _ in range(2) for batch in resumed] == unbroken


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            "--trainer.fast_dev_run true",
            "fast_dev_run is True; no checkpoint is left to go on from; use --trainer.max_epochs",
        ),
        ("--trainer.fast_dev_run 1", "fast_dev_run is 1; no checkpoint is left"),
        ("--trainer.barebones true", "barebones is True; a run logs and saves"),
        ("--trainer.reload_dataloaders_every_n_epochs 1", "demonstrations do not change"),
        ("--trainer.model_registry x", "model_registry is x; checkpoints stay in the run directory"),
        ("--trainer.limit_train_batches 0", "limit_train_batches is 0, so nothing would be trained"),
        ("--trainer.limit_train_batches 0.0", "limit_train_batches is 0.0, so nothing would be trained"),
        ("--trainer.max_steps 0", "max_steps is 0, so nothing would be trained"),
        ("--trainer.gradient_clip_val -1", "gradient_clip_val is -1; expected a number, at least 0"),
        ("--trainer.gradient_clip_val .nan", "gradient_clip_val is nan; expected a number, at least 0"),
        ("--trainer.min_epochs -3", "min_epochs is -3; expected a number, at least 0"),
        ("--trainer.num_nodes 2", "expected 1: a run is on one machine"),
        ("--trainer.precision 16-mixed --trainer.accelerator cpu", "AMP with fp16 is not supported on CPU"),
        ("--trainer.precision bf16-true", "precision is bf16-true; expected bf16-mixed or 16-mixed"),
        ("--trainer.callbacks x", "append yours with --callbacks+=CLASS"),
        ("--callbacks+=ModelCheckpoint", "more than one stateful callback of type `ModelCheckpoint`"),
        ("--callbacks+=EarlyStopping --callbacks.monitor x --callbacks.mode up", "a setting is impossible: "),
        ("--alignment.optimizer SGD --alignment.optimizer.lr -1", "a setting is impossible: ValueError"),
    ],
)
def test_what_cannot_be_is_refused_before_a_run_begins(words: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), *words.split())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--callbacks+=EarlyStopping --callbacks.monitor nothing", "Early stopping conditioned on metric `nothing`"),
        ("--trainer.val_check_interval 1000", "`val_check_interval` (1000) must be less than or equal"),
        ("--trainer.limit_train_batches 0.001", "requested to check 0.001 of the `train_dataloader`"),
    ],
)
def test_what_lightning_refuses_while_it_trains_is_one_line(words: str, told: str, tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), *words.split())
    assert answer.code == 2
    assert [line for line in answer.err.splitlines() if line.startswith("plp: ")] == [answer.err.splitlines()[-1]]
    assert told in answer.err


@pytest.mark.parametrize(
    "words", ["Timer --callbacks.duration 00:01:00:00", "StochasticWeightAveraging --callbacks.swa_lrs 1e-3"]
)
def test_callbacks_with_objects_as_defaults_are_kept_and_read_again(words: str, tmp_path: Path) -> None:
    run = fitted(tmp_path / "one", "--callbacks+", *words.split())
    assert "serialize" not in run.config.read_text()
    again = plp("fit", "--config", run.config, "--run_root", tmp_path / "two")
    assert again.code == 0, again
    one, two = (checkpoint(x, "adaptation")["state_dict"] for x in (run, smoke_run(tmp_path / "two")))
    assert same(one, two)
    one, two = (yaml.safe_load(x.config.read_text()) for x in (run, smoke_run(tmp_path / "two")))
    assert one | {"run_root": ""} == two | {"run_root": ""}


def test_averaged_weights_leave_frozen_parts_alone_and_are_resumed_exactly(tmp_path: Path) -> None:
    words = ["--callbacks+=EMAWeightAveraging", "--callbacks.decay", "0.9"]
    run = fitted(tmp_path / "whole", *words)
    before, after = (checkpoint(run, name)["state_dict"] for name in ("alignment", "adaptation"))
    frozen = [name for name in after if name.startswith(("policy.encoder.", "policy.decoder.", "policy.scaler."))]
    assert frozen
    assert all(torch.equal(before[name], after[name]) for name in frozen)
    where = "plp_lightning.methods.phase:Phase.log_parts"
    killed = dies(["fit", *tiny_smoke(tmp_path / "cut"), *words], where, 14, signal.SIGTERM)
    assert killed == 128 + signal.SIGTERM
    assert plp("fit", "--resume", smoke_run(tmp_path / "cut").path).code == 0
    assert same(after, checkpoint(smoke_run(tmp_path / "cut"), "adaptation")["state_dict"])


@pytest.mark.parametrize("precision", ["bf16-mixed", "64-true"])
@pytest.mark.parametrize("clip", ["0", "1.0"])
def test_precisions_train_with_clipped_gradients_and_without(precision: str, clip: str, tmp_path: Path) -> None:
    words = ["--trainer.gradient_clip_val", clip, "--alignment.epochs", "1", "--adaptation.epochs", "1"]
    fitted(tmp_path, "--trainer.precision", precision, *words)


def test_clipped_gradients_are_brought_to_scale_before_the_step() -> None:
    optimizer = FusedAdamW([torch.nn.Parameter(torch.zeros(1))])
    assert optimizer._step_supports_amp_scaling
    let_clip(optimizer)
    assert not optimizer._step_supports_amp_scaling


@pytest.mark.parametrize("profiler", ["simple", "advanced"])
def test_profiles_are_written_and_told(profiler: str, tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), "--trainer.profiler", profiler)
    file = smoke_run(tmp_path).phase("alignment") / "fit-profile.txt"
    assert f"alignment: its profile goes into {file}" in answer.out
    assert "training_step" in file.read_text()
