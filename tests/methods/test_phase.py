from __future__ import annotations

import csv
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import tiny
import torch
from lightning.pytorch import Callback, Trainer

from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.settings import build
from datamodules.types import BatchSpec
from plp_lightning.callbacks.checkpointing import RandomState, best_and_last, read_checkpoint
from plp_lightning.methods.optimization import CosineDecay
from plp_lightning.methods.plp import Adaptation, Alignment
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, DomainAdversarial, ImageReconstruction, TermFactory
from plp_lightning.runs.metrics_file import MetricsFile


def logged(folder: Path, name: str) -> list[float]:
    rows = list(csv.reader((folder / "metrics.csv").read_text().splitlines()))[1:]
    return [float(value) for _, metric, value in rows if metric == name]


def test_held_out_losses_are_means_over_all_held_out_steps(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Alignment(tiny.policy(data), tiny.terms("mmd"))
    make_trainer(epochs=1, logger=MetricsFile(tmp_path / "log")).fit(phase, datamodule=data)
    sums, counts = {}, {}
    for domain, rows in data.rows(tiny.PROXIES, "val").items():
        steps = data.datasets[domain].take(torch.from_numpy(rows))
        action = phase.policy({domain: steps.observation}, {domain: steps.task}).action[domain]
        sums[domain] = (action - steps.action).square().mean(dim=1).sum().item()
        counts[domain] = len(rows)
        assert logged(tmp_path / "log", f"val/bc_{domain}") == [pytest.approx(sums[domain] / counts[domain], rel=1e-4)]
    overall = sum(sums.values()) / sum(counts.values())
    assert logged(tmp_path / "log", "val/bc") == [pytest.approx(overall, rel=1e-4)]


def test_every_part_of_the_loss_has_its_curve(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Alignment(tiny.policy(data), tiny.terms("mmd", "tcc"))
    make_trainer(epochs=1, logger=MetricsFile(tmp_path / "log")).fit(phase, datamodule=data)
    steps = len(data.loader(BatchSpec(pairs="thinned")))
    for name in ("bc", "mmd", "tcc", "loss", "latent_std"):
        assert len(logged(tmp_path / "log", f"train/{name}")) == steps


def test_adamw_without_decay_is_the_default(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    phase = Alignment(policy, tiny.terms("adversarial"), optimizer=tiny.adamw(0.125), lr_scheduler=None)
    optimizer = phase.configure_optimizers()
    assert isinstance(optimizer, torch.optim.AdamW)
    (group,) = optimizer.param_groups
    assert (group["lr"], group["weight_decay"]) == (0.125, 0)
    assert {id(p) for p in group["params"]} == {id(p) for p in phase.parameters()}


def test_a_checkpoint_rebuilds_the_policy_without_its_configuration(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Adaptation(tiny.policy(data))
    make_trainer(RandomState(), *best_and_last(tmp_path / "c", "val/bc"), epochs=1).fit(phase, datamodule=data)
    assert {file.name for file in (tmp_path / "c").iterdir()} == {"best.ckpt", "last.ckpt"}
    for which in ("best", "last"):
        checkpoint = read_checkpoint(tmp_path / "c" / f"{which}.ckpt")
        card = checkpoint["policy"]
        problem = TransferProblem.from_dict(card["problem"])
        again = build(card, PortablePolicy, ["plp_lightning"], problem)
        again.load_state_dict(
            {n.removeprefix("policy."): v for n, v in checkpoint["state_dict"].items() if n.startswith("policy.")}
        )
        observation = {d: t.observation.take(slice(len(t))) for d, t in data.datasets.items()}
        task = {d: t.task for d, t in data.datasets.items()}
        for domain, action in phase.policy(observation, task).action.items():
            assert torch.equal(again(observation, task).action[domain], action)


def test_a_run_that_was_stopped_gives_the_weights_of_an_unbroken_one(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    def run(folder: str, epochs: int, resume: Path | None = None) -> dict[str, torch.Tensor]:
        data = tiny.data_module(trajectory_file, batch_size=100)
        phase = Alignment(tiny.policy(data), tiny.terms("mmd", "tcc"), optimizer=tiny.adamw(1e-3), lr_scheduler=None)
        trainer = make_trainer(RandomState(), *best_and_last(tmp_path / folder, "val/bc"), epochs=epochs)
        trainer.fit(phase, datamodule=data, ckpt_path=resume, weights_only=True)
        return {name: value.clone() for name, value in phase.state_dict().items()}

    unbroken = run("unbroken", 3)
    run("broken", 2)
    resumed = run("broken", 3, tmp_path / "broken" / "last.ckpt")
    assert all(torch.equal(unbroken[name], resumed[name]) for name in unbroken)


def test_cosine_lowers_the_rate_to_nothing_over_the_whole_phase(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Alignment(tiny.policy(data), tiny.terms("mmd"), optimizer=tiny.adamw(0.5), lr_scheduler=CosineDecay)
    rates: list[float] = []

    class Rates(Callback):
        def on_train_batch_start(self, trainer: Trainer, *_: object) -> None:
            rates.append(trainer.optimizers[0].param_groups[0]["lr"])

    trainer = make_trainer(Rates(), epochs=2)
    trainer.fit(phase, datamodule=data)
    steps = 2 * len(data.loader(BatchSpec()))
    assert rates == pytest.approx([0.25 * (1 + math.cos(math.pi * i / steps)) for i in range(steps)])
    assert trainer.optimizers[0].param_groups[0]["lr"] == pytest.approx(0)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (MMD, "weight"),
        (TCC, "weight"),
        (DomainAdversarial, "weight"),
        (DomainAdversarial, "penalty_weight"),
        (ImageReconstruction, "weight"),
    ],
)
def test_no_weight_is_below_zero(kind: TermFactory, name: str, trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    wanted = rf"{kind.__name__}.{name} is -0.1; expected a number, at least 0; change it"  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=wanted):
        Alignment(policy, {"term": partial(kind, **{name: -0.1})})


def test_weights_come_back_as_they_were(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    phase = Alignment(policy, {"mmd": partial(MMD, weight=0.0), "tcc": partial(TCC, weight=2.5)})
    assert {name: term.weight for name, term in phase.terms.items()} == {"mmd": 0.0, "tcc": 2.5}
