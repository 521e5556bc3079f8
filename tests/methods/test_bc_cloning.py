from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import seen
import tiny
import torch
from command import ROOT, SMOKE, checkpoint, data_root, dies, plp, results, same, smoke_run, tiny_smoke
from lightning.pytorch import Trainer
from torch import Tensor

from datamodules import settings
from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec, Observation
from plp_lightning.callbacks.freezing import FreezeGuard
from plp_lightning.methods import Alignment, BCAdaptation, BCCloning, BCPolicy
from plp_lightning.methods.policy import AligningPolicy
from plp_lightning.networks import ImageEncoding, Sharing

OVERLAY = ["--config", str(ROOT / "configs" / "methods" / "bc.yaml")]
SMALL, LARGE = tiny.spec("small", 3, 2), tiny.spec("large", 7, 5)
TASKS = ("reach", "push", "lift")
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"


class Quiet(BCCloning):
    """Logs nothing."""

    logs_now = False  # type: ignore[assignment]


def build(columns: Sharing = "own") -> BCPolicy:
    torch.manual_seed(0)
    domains = (SMALL, LARGE)
    problem = tiny.problem(domains, TASKS, {spec.name: tiny.statistics(spec, 3) for spec in domains})
    return BCPolicy(problem, hidden=12, layers=2, columns=columns)


def flat(data: TransferDataModule, layers: int = 3) -> BCPolicy:
    torch.manual_seed(0)
    return BCPolicy(data.problem, hidden=16, layers=layers)


def by_hand(policy: BCPolicy, number: int, state: Tensor, task: int, shared: bool) -> Tensor:
    """One state's action in float64, layer after layer."""
    name, sizes, actions = ("small", "large")[number], (3, 7), (2, 5)
    first = 0 if shared else sum(sizes[:number])
    columns = torch.zeros(max(sizes) if shared else sum(sizes), dtype=torch.float64)
    columns[first : first + sizes[number]] = policy.scaler(state[None], name)[0].double()
    eye = torch.eye(3, dtype=torch.float64)
    x = torch.cat([eye[task], columns, eye[number, :2]])
    linear = [module for module in policy.net.net if isinstance(module, torch.nn.Linear)]
    for i, layer in enumerate(linear):
        x = layer.weight.double() @ x + layer.bias.double()
        x = x * 0.5 * (1 + torch.erf(x / 2**0.5)) if i < len(linear) - 1 else torch.tanh(x)
    start = 0 if shared else sum(actions[:number])
    return x[start : start + actions[number]].detach()


@pytest.mark.parametrize("columns", ["own", "shared"])
def test_state_domain_and_task_enter_one_perceptron(columns: Sharing) -> None:
    policy, draw = build(columns), torch.Generator().manual_seed(1)
    state = {"small": torch.randn(4, 3, generator=draw), "large": torch.randn(5, 7, generator=draw)}
    task = {"small": torch.tensor([0, 2, 1, 1]), "large": torch.tensor([2, 1, 0, 0, 2])}
    actions = policy.predict_actions({d: Observation(s) for d, s in state.items()}, task)
    for number, (domain, rows) in enumerate(state.items()):
        for i, row in enumerate(rows):
            expected = by_hand(policy, number, row, int(task[domain][i]), columns == "shared")
            torch.testing.assert_close(actions[domain][i].double(), expected, rtol=1e-4, atol=1e-6)


def test_it_is_as_deep_and_wide_as_the_three_parts_of_plp() -> None:
    domains = [SMALL, LARGE]
    net = BCPolicy(tiny.problem(domains, TASKS)).net.net
    portable = tiny.PortablePolicy(tiny.problem(domains, TASKS), encoder_layers=3)  # the paper's depth
    parts = (portable.encoder, portable.common, portable.decoder)
    assert sum(isinstance(layer, torch.nn.GELU) for layer in net) == 10
    assert sum(isinstance(layer, torch.nn.GELU) for part in parts for layer in part.modules()) == 10
    assert {layer.out_features for layer in net if isinstance(layer, torch.nn.Linear)} == {192, 7}


def test_a_saturated_action_still_has_a_gradient() -> None:
    policy = build()
    with torch.no_grad():
        policy.net.net[-1].bias.fill_(50.0)
    action = policy.predict_actions({"small": Observation(torch.zeros(1, 3))}, {"small": torch.tensor([0])})["small"]
    action.sum().backward()
    assert torch.equal(action, torch.ones(1, 2))
    torch.testing.assert_close(policy.net.net[-1].bias.grad[:2], torch.tensor([0.1, 0.1]))


def test_the_policy_is_rebuilt_from_problem_and_blueprint() -> None:
    policy = build()
    plain = json.loads(json.dumps(settings.blueprint(policy, ["problem"])))
    other = settings.build(plain, BCPolicy, ["plp_lightning"], policy.problem)
    other.load_state_dict(policy.state_dict())
    assert not isinstance(policy, AligningPolicy)
    assert settings.blueprint(other, ["problem"]) == settings.blueprint(policy, ["problem"])
    state = np.ones((2, 7), np.float32)
    np.testing.assert_array_equal(*(p.act(Observation(state), "large", ["lift", "push"]) for p in (policy, other)))


def test_what_a_camera_saw_decides_along(tmp_path: Path) -> None:
    seen.write(tmp_path / "seen.hdf5", 2)
    data = seen.data_module(tmp_path / "seen.hdf5")
    torch.manual_seed(0)
    policy = BCPolicy(data.problem, hidden=16, layers=1, image_encoder=ImageEncoding((4, 6), 12))
    steps = next(iter(data.loader(BCCloning.batch_spec))).steps
    task = {domain: s.task for domain, s in steps.items()}
    bright = policy.predict_actions({d: s.observation for d, s in steps.items()}, task)
    dark = {d: s.observation._replace(images=s.observation.map(torch.zeros_like).images) for d, s in steps.items()}
    assert not any(torch.equal(bright[d], action) for d, action in policy.predict_actions(dark, task).items())
    alone = {d: policy.predict_actions({d: s.observation}, {d: s.task})[d] for d, s in steps.items()}
    assert all(torch.allclose(bright[d], action, atol=1e-6) for d, action in alone.items())


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_the_loss_is_the_mean_over_samples_of_squared_errors(reduction: str, trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Quiet(flat(data), reduction)  # type: ignore[arg-type]
    batch = next(iter(data.loader(phase.batch_spec)))
    loss = phase.training_step(batch, 0)
    errors = []
    for domain, steps in batch.steps.items():
        for state, action, task in zip(steps.observation.state, steps.action, steps.task, strict=True):
            made = phase.policy.predict_actions({domain: Observation(state[None])}, {domain: task[None]})[domain][
                0
            ].detach()
            squares = [(float(x) - float(y)) ** 2 for x, y in zip(made, action, strict=True)]
            errors.append(sum(squares) / (len(squares) if reduction == "mean" else 1))
    assert loss.item() == pytest.approx(sum(errors) / len(errors), rel=1e-5)


def test_a_clone_of_one_domain_learns_from_its_demonstrations_alone(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = Quiet(flat(data), domains=["tall"])
    batch = next(iter(data.loader(phase.batch_spec)))
    assert set(batch.steps) == {"flat", "tall"}
    alone = batch._replace(steps={"tall": batch.steps["tall"]})
    assert torch.equal(phase.training_step(batch, 0), Quiet(phase.policy).training_step(alone, 0))
    trainer = make_trainer(epochs=1)
    trainer.fit(phase, datamodule=data)
    assert "val/bc_tall" in trainer.callback_metrics
    assert "val/bc_flat" not in trainer.callback_metrics


@pytest.mark.parametrize("domains", [["round"], []])
def test_a_clone_needs_a_domain_that_exists(domains: list[str], trajectory_file: Path) -> None:
    with pytest.raises(ConfigError, match=r"domains is \[.*\]; expected some of: flat, tall"):
        BCCloning(flat(tiny.data_module(trajectory_file)), domains=domains)


def test_adaptation_changes_all_weights_and_leaves_the_scaling(
    trajectory_file: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file)
    phase = BCAdaptation(flat(data), optimizer=tiny.adamw(3e-3))
    before = {name: value.clone() for name, value in phase.policy.state_dict().items()}
    make_trainer(FreezeGuard(), epochs=1).fit(phase, datamodule=data)
    changed = {name for name, value in phase.policy.state_dict().items() if not torch.equal(value, before[name])}
    assert changed == {name for name in before if not name.startswith("scaler.")}
    assert phase.frozen == {}


def test_proxies_are_cloned_first_and_mixed_into_the_target_task_then(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    assert (BCCloning.batch_spec, BCAdaptation.batch_spec) == (BatchSpec("proxy_tasks"), BatchSpec("mix"))
    target = tiny.TASKS.index(tiny.TARGET)
    for phase, expected in ((BCCloning, {False}), (BCAdaptation, {True, False})):
        drawn = [batch.steps for batch in data.loader(phase.batch_spec)]
        assert {bool(x) for steps in drawn for x in steps["flat"].task == target} == expected
        assert not any((steps["tall"].task == target).any() for steps in drawn if "tall" in steps)


def test_phases_and_policies_of_other_methods_do_not_mix(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    with pytest.raises(ConfigError, match="phase BCCloning trains a BCPolicy, found a PortablePolicy"):
        BCCloning(tiny.policy(data))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="phase Alignment trains a PortablePolicy, found a BCPolicy"):
        Alignment(flat(data), tiny.terms())  # type: ignore[arg-type]


def test_it_learns_what_was_demonstrated_and_nothing_else(tmp_path: Path) -> None:
    options = ["--data.root", data_root(), "--run_root", tmp_path, "--evaluation.latent_states", "0"]
    answer = plp("fit", *SMOKE, *OVERLAY, *options)
    assert answer.code == 0, answer
    found = json.loads(smoke_run(tmp_path, "bc").results.read_text())
    assert found["alignment"] == {}
    assert found["proxy"]["success"] >= 0.8
    assert found["source"]["before"] <= 0.1
    assert found["source"]["success"] >= 0.5
    assert found["target"]["success"] <= 0.1  # nothing carries over to a domain whose state means something else


@pytest.mark.parametrize("step", [2, 14])
def test_a_killed_run_resumes_to_the_same_weights(step: int, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    answer = plp("fit", *tiny_smoke(whole), *OVERLAY)
    assert answer.code == 0, answer
    assert dies(["fit", *tiny_smoke(broken), *OVERLAY], STEP, step, signal.SIGKILL) == -signal.SIGKILL
    run, expected = smoke_run(broken, "bc"), smoke_run(whole, "bc")
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    for phase in ("alignment", "adaptation"):
        ours, theirs = checkpoint(run, phase), checkpoint(expected, phase)
        assert same(ours["state_dict"], theirs["state_dict"])
        assert same(ours["optimizer_states"], theirs["optimizer_states"])
    assert results(run) == results(expected)
    assert plp("test", run.path, "--episodes", "2").code == 0
