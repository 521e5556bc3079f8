"""Optimizers and learning rates: the phase's length is theirs, and a run that goes on keeps its rates."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Callback, Trainer
from torch.optim.lr_scheduler import CosineAnnealingLR, StepLR

from plp_lightning.callbacks.checkpointing import RandomState, best_and_last
from plp_lightning.methods.optimization import CosineDecay, FusedAdamW, LinearDecay, SchedulerFactory, slowed
from plp_lightning.methods.plp import Alignment


class Rates(Callback):
    """Notes the learning rate of every step, and the epoch that it is in."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, float]] = []

    def on_train_batch_start(self, trainer: Trainer, *_: object) -> None:
        self.seen.append((trainer.current_epoch, trainer.optimizers[0].param_groups[0]["lr"]))


def optimizer(rate: float = 1.0) -> FusedAdamW:
    return FusedAdamW([torch.nn.Parameter(torch.zeros(1))], lr=rate)


def former_factor(epoch: int, epochs: int, slowdown: float) -> float:
    """Of the rate in an epoch, as CDIL once set it before each epoch."""
    left = (epochs - epoch) / (slowdown * epochs) if slowdown > 0 else 1.0
    return min(1.0, left)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("epochs", [1, 2, 7, 20])
def test_linear_decay_has_the_factor_of_each_epoch(share: float, epochs: int) -> None:
    adam = optimizer(0.5)
    schedule = LinearDecay(adam, share)
    schedule.span(99, epochs)
    found = []
    for _ in range(epochs):
        found.append(adam.param_groups[0]["lr"])
        adam.step()
        schedule.step()
    assert found == pytest.approx([0.5 * former_factor(epoch, epochs, share) for epoch in range(epochs)])
    assert found == [0.5 * slowed(epoch, epochs, share) for epoch in range(epochs)]


def test_the_first_epoch_of_linear_decay_over_the_whole_phase_has_the_full_rate() -> None:
    assert [slowed(epoch, 4, 1.0) for epoch in range(4)] == [1.0, 0.75, 0.5, 0.25]


def test_cosine_decay_is_torchs_over_all_steps() -> None:
    ours, theirs = optimizer(), optimizer()
    schedule = CosineDecay(ours)
    schedule.span(37, 99)
    reference = CosineAnnealingLR(theirs, T_max=37)
    for _ in range(37):
        assert ours.param_groups[0]["lr"] == theirs.param_groups[0]["lr"]
        for adam, step in ((ours, schedule), (theirs, reference)):
            adam.step()
            step.step()
    assert ours.param_groups[0]["lr"] == theirs.param_groups[0]["lr"] == pytest.approx(0)


def test_adamw_is_fused_without_decay_and_has_the_moments_asked_for() -> None:
    (group,) = optimizer(0.25).param_groups
    assert (group["lr"], group["weight_decay"], group["betas"], group["fused"]) == (0.25, 0.0, (0.9, 0.999), True)
    (group,) = FusedAdamW([torch.nn.Parameter(torch.zeros(1))], 0.5, 0.1, 0.5).param_groups
    assert (group["lr"], group["weight_decay"], group["betas"]) == (0.5, 0.1, (0.5, 0.999))


def run(
    trajectory_file: Path, folder: Path, make_trainer: Callable[..., Trainer], epochs: int, until: int, **given: object
) -> list[tuple[int, float]]:
    """Rates of a phase of so many epochs that is stopped after some of them, or that goes on."""
    data, rates = tiny.data_module(trajectory_file, batch_size=100), Rates()
    phase = Alignment(tiny.policy(data), optimizer=tiny.adamw(0.5), **given)  # type: ignore[arg-type]

    class Stop(Callback):
        def on_train_epoch_end(self, trainer: Trainer, *_: object) -> None:
            trainer.should_stop = trainer.current_epoch + 1 == until

    trainer = make_trainer(RandomState(), *best_and_last(folder, "val/bc"), rates, Stop(), epochs=epochs)
    last = folder / "last.ckpt"
    trainer.fit(phase, datamodule=data, ckpt_path=last if last.exists() else None, weights_only=True)
    return rates.seen


SCHEDULES: dict[str, SchedulerFactory] = {
    "cosine": CosineDecay,
    "linear": LinearDecay,
    "linear over all": partial(LinearDecay, share=1.0),
    "torch's own": partial(StepLR, step_size=1, gamma=0.5),
}


@pytest.mark.parametrize("name", SCHEDULES)
def test_a_run_that_goes_on_has_the_rates_of_an_unbroken_one(
    name: str, trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    each = partial(run, trajectory_file, make_trainer=make_trainer, epochs=4, lr_scheduler=SCHEDULES[name])
    unbroken = each(folder=tmp_path / "unbroken", until=4)
    broken = each(folder=tmp_path / "broken", until=2)
    assert {epoch for epoch, _ in broken} == {0, 1}
    assert broken + each(folder=tmp_path / "broken", until=4) == unbroken
    assert len({rate for _, rate in unbroken}) > 1


def test_rates_of_a_phase_follow_its_epochs_or_its_steps(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    each = partial(run, trajectory_file, make_trainer=make_trainer, epochs=4, until=4)
    for epoch, rate in each(folder=tmp_path / "linear", lr_scheduler=LinearDecay):
        assert rate == pytest.approx(0.5 * former_factor(epoch, 4, 0.5))
    cosine = [rate for _, rate in each(folder=tmp_path / "cosine", lr_scheduler=CosineDecay)]
    steps = len(cosine)
    assert cosine == pytest.approx([0.25 * (1 + math.cos(math.pi * i / steps)) for i in range(steps)])
    assert {rate for _, rate in each(folder=tmp_path / "constant", lr_scheduler=None)} == {0.5}
