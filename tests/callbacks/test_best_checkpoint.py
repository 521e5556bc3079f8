"""The best checkpoint is told by what a phase names, and an interruption does not make it forget its best."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from plp_lightning import methods
from plp_lightning.callbacks.checkpointing import BestCheckpoint, best_and_last, read_checkpoint
from plp_lightning.methods.bc import BCCloning, BCPolicy
from plp_lightning.methods.phase import Phase


class Renamed(BCCloning):
    """Logs its held-out loss under another name than runs did before."""

    monitor = "val/loss"

    def log(self, name: str, value: object, **options: object) -> None:  # type: ignore[override]
        super().log("val/loss" if name == "val/bc" else name, value, **options)  # type: ignore[arg-type]


def before(folder: Path) -> list[ModelCheckpoint]:
    """The callbacks of runs that were begun when every phase called its loss ``val/bc``."""
    best = ModelCheckpoint(folder, "best", monitor="val/bc", save_top_k=1, enable_version_counter=False)
    return [best, best_and_last(folder, None)[0]]


def test_the_state_has_the_name_that_it_had_in_runs_begun_before(tmp_path: Path) -> None:
    assert BestCheckpoint(tmp_path, "val/loss").state_key == before(tmp_path)[0].state_key


@pytest.mark.parametrize(("score", "kept"), [(1e-9, True), (1e9, False)])
def test_a_run_begun_before_goes_on_with_the_best_that_it_had(
    score: float, kept: bool, tmp_path: Path, trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    make_trainer(*before(tmp_path), epochs=1).fit(BCCloning(BCPolicy(data.problem, hidden=8)), datamodule=data)
    saved = read_checkpoint(tmp_path / "last.ckpt")  # without its hash, as runs were begun before
    record = saved["callbacks"][BestCheckpoint(tmp_path, "val/bc").state_key]
    record["best_model_score"] = record["kth_value"] = torch.tensor(score)
    record["best_k_models"] = dict.fromkeys(record["best_k_models"], torch.tensor(score))
    torch.save(saved, tmp_path / "last.ckpt")
    best = (tmp_path / "best.ckpt").read_bytes()

    trainer = make_trainer(*best_and_last(tmp_path, Renamed.monitor), epochs=2)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*callbacks used to create the checkpoint.*")
        phase = Renamed(BCPolicy(data.problem, hidden=8))
        trainer.fit(phase, datamodule=data, ckpt_path=tmp_path / "last.ckpt", weights_only=True)
    assert ((tmp_path / "best.ckpt").read_bytes() == best) == kept
    assert {file.name for file in tmp_path.glob("*.ckpt")} == {"best.ckpt", "last.ckpt"}


def test_nothing_is_chosen_where_nothing_is_held_out(tmp_path: Path) -> None:
    (last,) = best_and_last(tmp_path, None)
    assert (last.filename, last.monitor) == ("last", None)


def test_phases_name_what_they_are_chosen_by_and_whether_their_policy_acts() -> None:
    phases = [found for found in vars(methods).values() if isinstance(found, type) and issubclass(found, Phase)]
    named = {phase.__name__: (phase.monitor, phase.policy_acts) for phase in phases}
    others = {name: found for name, found in named.items() if found != ("val/bc", True)}
    cdil = dict.fromkeys(("CdilPositions", "CdilAlignment", "CdilDynamics"), ("val/loss", False))
    assert others == {
        **cdil,
        "CdilAdaptation": ("val/loss", True),
        "GamaPretraining": ("val/bc", False),
        "StateOnlyAdaptation": ("val/next", True),
    }
