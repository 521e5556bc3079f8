"""PLP-T without source actions: what each loss reads and teaches, and that it learns without reading any."""

from __future__ import annotations

import itertools
import json
import os
import signal
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import tiny
import torch
from command import ROOT, SMOKE, checkpoint, data_root, plp, results, same, smoke_run, tiny_smoke
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import Batch
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.callbacks.preemption import Preemption
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.losses import mmd, tcc
from plp_lightning.methods.plp.terms import MMD, TCC, DomainAdversarial, ImageReconstruction
from plp_lightning.methods.state_only.phases import StateOnlyAdaptation, StateOnlyAlignment, StateOnlyPolicy
from plp_lightning.runs.metrics_file import read_rows

OVERLAY = ["--config", str(ROOT / "configs" / "methods" / "plp_t_noaction.yaml")]
PHASES = ("alignment", "adaptation")
LONGER = [
    *("--alignment.epochs", "24", "--adaptation.epochs", "10", "--alignment.next_reduction", "sum"),
    *("--adaptation.next_reduction", "sum", "--evaluation.latent_states", "0"),
    *("--evaluation.every_n_epochs", "{alignment: 0, adaptation: 0}"),
]


def build(data: TransferDataModule) -> StateOnlyPolicy:
    torch.manual_seed(0)
    return StateOnlyPolicy(data.problem, latent=8, hidden=16, decoder_state="all")


class Recorded(StateOnlyAlignment):
    """Keeps the parts of a step instead of logging them."""

    logs_now = True  # type: ignore[assignment]

    def log_parts(self, parts: dict[str, Tensor], batch_size: int) -> None:
        self.parts, self.batch_size = parts, batch_size


def one_batch(data: TransferDataModule, phase: StateOnlyAlignment | StateOnlyAdaptation) -> Batch:
    return next(iter(data.loader(phase.batch_spec)))


@torch.no_grad()
def next_and_inverse(data: TransferDataModule, policy: StateOnlyPolicy, batch: Batch) -> dict[str, float]:
    """L_next and L_IDM, a step at a time, with what follows looked up in the dataset."""
    errors: dict[str, list[float]] = {"next": [], "inverse": []}
    for domain, steps in batch.steps.items():
        dataset = data.datasets[domain]
        for row in steps.row.tolist():
            here, after = (dataset.observation.take(slice(r, r + 1)) for r in (row, int(dataset.next_row[row])))
            z, following = policy.encode({domain: here})[domain], policy.encode({domain: after})[domain]
            plan = policy.latent_action({domain: z}, {domain: dataset.task[row : row + 1]})[domain]
            errors["next"].append((plan - following).square().mean().item())
            if domain == "tall":
                action = policy.decode({domain: following}, {domain: here})[domain]
                errors["inverse"].append((action - dataset.action[row]).square().mean().item())
    return {name: sum(found) / len(found) for name, found in errors.items() if found}


def test_the_parts_of_a_step_are_the_separate_losses_and_their_weighted_sum(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Recorded(build(data), {"mmd": partial(MMD, weight=0.3), "tcc": partial(TCC, weight=0.7)})
    batch = one_batch(data, phase)
    total = phase.training_step(batch, 0)
    latents = {d: phase.policy.encode({d: s.observation})[d] for d, s in batch.steps.items()}
    frames = {d: phase.policy.encode({d: s.observation})[d][s.frame] for d, s in batch.pairs.items()}
    (first, second), (u, v) = frames.values(), batch.pairs.values()
    expected = next_and_inverse(data, phase.policy, batch)
    expected["mmd"] = mmd([*latents.values()], bandwidths=tiny.KERNELS).item()
    expected["tcc"] = tcc(first, u.mask, second, v.mask).item()
    assert set(phase.parts) == {*expected, "loss", "latent_std"}
    for name, value in expected.items():
        assert phase.parts[name].item() == pytest.approx(value, rel=1e-4, abs=1e-6), name
    weights = {"mmd": 0.3, "tcc": 0.7}
    assert total.item() == pytest.approx(sum(weights.get(n, 1.0) * v for n, v in expected.items()), rel=1e-4)
    spread = torch.cat([*latents.values()]).std(dim=0).mean()
    torch.testing.assert_close(phase.parts["latent_std"], spread)
    assert phase.batch_size == 32


def slopes(loss: Tensor, module: torch.nn.Module) -> float:
    parameters = list(module.parameters())
    found = torch.autograd.grad(loss, parameters, retain_graph=True, allow_unused=True)
    return sum(float(g.abs().sum()) for g in found if g is not None)


def test_the_prediction_teaches_encoder_and_common_policy_and_the_inverse_dynamics_the_decoder(
    trajectory_file: Path,
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Recorded(build(data), tiny.terms("mmd", "tcc"))
    phase.training_step(one_batch(data, phase), 0)
    policy = phase.policy
    parts = {"encoder": policy.encoder, "common": policy.common, "decoder": policy.decoder}
    losses = {name: phase.parts[name] for name in ("next", "inverse", "mmd", "tcc")}
    taught = {name: {part for part, m in parts.items() if slopes(loss, m) > 0} for name, loss in losses.items()}
    assert taught["next"] == {"encoder", "common"}
    assert taught["inverse"] == {"decoder"}
    assert taught["mmd"] == taught["tcc"] == {"encoder"}


def trained(data: TransferDataModule, make_trainer: Callable[..., Trainer]) -> Mapping[str, Tensor]:
    """Weights after both phases."""
    policy = build(data)
    for phase in (
        StateOnlyAlignment(policy, tiny.terms("mmd", "tcc"), optimizer=tiny.adamw(3e-3)),
        StateOnlyAdaptation(policy, optimizer=tiny.adamw(3e-3)),
    ):
        make_trainer(FreezeGuard()).fit(phase, datamodule=data)
    return policy.state_dict()


def test_no_action_of_the_source_domain_is_ever_read(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    honest, blank = tiny.data_module(trajectory_file), tiny.data_module(trajectory_file)
    blank.datasets["flat"].action.fill_(torch.nan)
    expected = trained(honest, make_trainer)
    found = trained(blank, make_trainer)
    assert same(dict(found), dict(expected))
    assert all(value.isfinite().all() for name, value in found.items() if name != "scaler.limit")
    blank.datasets["tall"].action.fill_(torch.nan)
    assert not same(dict(trained(blank, make_trainer)), dict(expected))


class Watched(StateOnlyAdaptation):
    """Computes each step's loss a second time, from observations."""

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        loss = super().training_step(batch, batch_idx)
        data = self.trainer.datamodule  # type: ignore[attr-defined]
        assert loss.item() == pytest.approx(next_and_inverse(data, self.policy, batch)["next"], rel=1e-4)
        self.domains = getattr(self, "domains", set()) | set(batch.steps)
        return loss


def test_adaptation_teaches_the_common_policy_alone_to_foresee(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file, mix_ratio=1.0)
    phase = Watched(build(data), optimizer=tiny.adamw(3e-3, 0.1))
    before = {name: value.clone() for name, value in phase.state_dict().items()}
    make_trainer(FreezeGuard(), epochs=1).fit(phase, datamodule=data)
    changed = {name for name, value in phase.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if name.startswith("policy.common.")}
    assert phase.domains == {"flat", "tall"}


def test_it_acts_in_the_target_domain_alone(trajectory_file: Path) -> None:
    assert build(tiny.data_module(trajectory_file)).acts_in == ("tall",)


def test_inverse_dynamics_has_to_see_the_state(trajectory_file: Path) -> None:
    blind = StateOnlyPolicy(tiny.data_module(trajectory_file).problem, latent=8, hidden=16, decoder_state="none")
    with pytest.raises(
        ConfigError, match=r"decoder_state is 'none', but inverse dynamics has to see the state; set it to 'prop"
    ):
        StateOnlyAlignment(blind, tiny.terms("mmd"))


def test_every_setting_of_alignment_arrives_under_its_name(trajectory_file: Path) -> None:
    phase = StateOnlyAlignment(
        build(tiny.data_module(trajectory_file)),
        {
            "mmd": partial(MMD, weight=0.2, bandwidths=(0.7,)),
            "tcc": partial(TCC, weight=0.3),
            "adversarial": partial(DomainAdversarial, weight=0.4, penalty_weight=0.5),
            "reconstruction": partial(ImageReconstruction, weight=0.6),
        },
    )
    weights = {name: term.weight for name, term in phase.terms.items()}
    assert weights == {"mmd": 0.2, "tcc": 0.3, "adversarial": 0.4, "reconstruction": 0.6}
    assert phase.terms["adversarial"].penalty_weight == 0.5
    assert phase.terms["mmd"].bandwidths == (0.7,)


def test_its_phases_train_no_other_policy(trajectory_file: Path) -> None:
    policy = tiny.policy(tiny.data_module(trajectory_file))
    with pytest.raises(ConfigError, match="phase StateOnlyAdaptation trains a StateOnlyPolicy, found a PortablePolicy"):
        StateOnlyAdaptation(policy)  # type: ignore[arg-type]
    assert issubclass(StateOnlyAlignment, Alignment)


def stop_at_step(patch: pytest.MonkeyPatch, nth: int) -> None:
    """Let this process be asked to stop after so many training steps, as a cluster asks."""
    at_step, calls = Preemption.on_train_batch_end, itertools.count(1)

    def stopping(self: Preemption, *words: Any) -> None:
        if next(calls) == nth:
            os.kill(os.getpid(), signal.SIGTERM)
        at_step(self, *words)

    patch.setattr(Preemption, "on_train_batch_end", stopping)


def test_a_run_is_scored_where_it_acts_resumes_to_the_same_weights_and_is_tested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = [*tiny_smoke(tmp_path / "unbroken"), *OVERLAY]
    answer = plp("fit", *options)
    assert (answer.code, answer.err) == (0, "")
    unbroken = smoke_run(tmp_path / "unbroken", "plp_t_noaction")
    found = json.loads(unbroken.results.read_text())
    assert {"target", "proxy"} <= found.keys()
    assert not {"source", "proxy_source"} & found.keys()
    assert "source domain" not in answer.out
    logged = {phase: {name for _, name, _ in read_rows(unbroken.phase(phase) / "metrics.csv")} for phase in PHASES}
    assert {"train/next", "train/inverse", "train/latent_std", "val/next", "val/bc"} <= logged["alignment"]
    assert "val/bc_flat" not in logged["alignment"]
    assert {"train/next", "val/next"} <= logged["adaptation"]
    assert "val/bc" not in logged["adaptation"]

    broken = [*tiny_smoke(tmp_path / "broken"), *OVERLAY]
    with monkeypatch.context() as patch:
        stop_at_step(patch, 8)
        assert plp("fit", *broken).code == 128 + signal.SIGTERM
    run = smoke_run(tmp_path / "broken", "plp_t_noaction")
    assert plp("fit", "--resume", run.path).code == 0
    for phase in PHASES:
        assert same(checkpoint(run, phase)["state_dict"], checkpoint(unbroken, phase)["state_dict"])
    assert results(run) == results(unbroken)

    assert plp("test", run.path, "--episodes", "3").code == 0
    tested = json.loads((run.path / "test.json").read_text())["trials"]
    assert {name: outcome["episodes"] for name, outcome in tested.items()} == {"target": 3, "proxy": 3}
    answer = plp("validate", run.path)
    assert "val/bc_tall" in answer.out
    assert "val/bc_flat" not in answer.out


def test_it_learns_to_act_and_then_to_foresee_a_task_of_which_it_saw_source_states_alone(tmp_path: Path) -> None:
    """Transfer itself is left out: on this pair of domains it rarely succeeds, as docs/methods says.

    So short a training leaves success on proxy tasks to the seed: 0.13 to 0.72 for seeds 0 to 4, 0.28 for this one.
    What was learnt is told by the errors; success has only to be there.
    """
    options = [*SMOKE, *OVERLAY, "--data.root", data_root(), "--run_root", tmp_path, *LONGER]
    answer = plp("fit", *options)
    assert answer.code == 0, answer
    run = smoke_run(tmp_path, "plp_t_noaction")
    assert json.loads(run.results.read_text())["proxy"]["success"] >= 0.1
    names = zip(PHASES, ("val/bc", "val/next"), strict=True)
    acting, foreseeing = ([v for _, n, v in read_rows(run.phase(p) / "metrics.csv") if n == name] for p, name in names)
    assert float(acting[-1]) < 0.08, "actions of zero have an error of 0.19"
    assert float(foreseeing[-1]) < float(foreseeing[0]) / 3
