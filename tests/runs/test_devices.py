"""Policies compute on the trainer's device after training too; without a GPU that is the processor."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
import torch
from command import plp, results, smoke_run, tiny_smoke
from torch import Tensor, nn

from datamodules.types import Observation
from plp_lightning.cli.config import parse
from plp_lightning.evaluation.held_out import held_out_actions
from plp_lightning.methods.policy import Policy
from plp_lightning.runs import assessment, experiment, fit
from plp_lightning.runs.devices import device_name, on_device, resolved_device
from plp_lightning.runs.trainer import quiet_lightning

CPU = torch.device("cpu")


class Elsewhere(Policy):
    """A policy that is where no numbers are, and hears where its inputs are."""

    def __init__(self) -> None:
        specs = [domain.simulator.spec(name) for name, domain in tiny.domains().items()]
        super().__init__(tiny.problem(specs, tiny.TASKS))
        self.weight = nn.Parameter(torch.zeros(1, device="meta"))
        self.heard = set[str]()

    def predict_actions(
        self, observation: Mapping[str, Observation[Tensor]], task: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        self.heard |= {seen.state.device.type for seen in observation.values()} | {t.device.type for t in task.values()}
        return {domain: torch.zeros(len(seen.state), 2) for domain, seen in observation.items()}


@pytest.mark.parametrize("fails", [False, True])
def test_a_module_comes_back(fails: bool) -> None:
    class Travelling(nn.Module):
        def to(self, place: Any) -> Any:  # type: ignore[override]
            ways.append(str(place))

        def cpu(self) -> Any:
            ways.append("cpu")

    ways: list[str] = []
    with (
        pytest.raises(KeyError) if fails else warnings.catch_warnings(),
        on_device(Travelling(), torch.device("cuda:0")),
    ):
        ways.append("block")
        if fails:
            raise KeyError
    assert ways == ["cuda:0", "block", "cpu"]


def test_a_policy_acts_where_it_is() -> None:
    policy = Elsewhere()
    states = Observation(np.zeros((3, 5), np.float32))
    assert policy.act(states, "tall", "goal_0").shape == (3, 2)
    actor = policy.actor("tall", ["goal_0", "goal_1", "goal_2"])
    actor(states, np.arange(3))
    actor(states.take([0, 2]), np.array([0, 2]))
    assert policy.heard == {"meta"}


def test_tasks_travel_only_when_episodes_have_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, sent = Elsewhere(), list[list[str]]()
    real = policy._task_ids

    def ids(names: Sequence[str]) -> Tensor:
        sent.append([*names])
        return real(names)

    monkeypatch.setattr(policy, "_task_ids", ids)
    actor = policy.actor("tall", ["goal_0", "goal_1", "goal_2"])
    for running in ([0, 1, 2], [0, 1, 2], [1, 2], [1, 2], [0, 2]):
        actor(Observation(np.zeros((len(running), 5), np.float32)), np.array(running))
    assert sent == [["goal_0", "goal_1", "goal_2"], ["goal_1", "goal_2"], ["goal_0", "goal_2"]]


def test_held_out_actions_are_predicted_where_the_policy_is(tmp_path: Path) -> None:
    looked_at = assessment.Assessment(parse(tiny_smoke(tmp_path)), tmp_path / "none.ckpt", tmp_path)
    looked_at.__dict__["policy"] = policy = Elsewhere()
    found = held_out_actions(looked_at.policy, looked_at.data)
    assert policy.heard == {"meta"}
    assert all(len(predicted) == len(shown) for predicted, shown in found.values())


def test_the_device_is_the_trainers_or_the_processor() -> None:
    assert resolved_device({"accelerator": "cpu", "devices": 1}) == CPU
    assert resolved_device({"accelerator": "tpu", "devices": 1}) == CPU
    expected = "cuda" if torch.cuda.is_available() else "cpu"
    assert resolved_device({"accelerator": "gpu", "devices": 1}).type == expected
    assert device_name(CPU) == "cpu"


def test_final_evaluation_and_scores_are_made_on_the_trainers_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, made = [False], list[str]()

    @contextmanager
    def noted(module: nn.Module, device: torch.device) -> Iterator[None]:
        there[0] = True
        with on_device(module, device):
            yield
        there[0] = False

    def watched(name: str) -> Any:
        real = getattr(experiment.Experiment, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            assert there[0], f"{name} on the processor"
            made.append(name)
            return real(*args, **kwargs)

        return call

    monkeypatch.setattr(fit, "on_device", noted)
    for name in ("evaluate", "alignment"):
        monkeypatch.setattr(experiment.Experiment, name, watched(name))
    assert plp("fit", *tiny_smoke(tmp_path)).code == 0
    assert made == ["evaluate", "alignment"] * 2
    assert results(smoke_run(tmp_path))["device"] == device_name(resolved_device({"accelerator": "auto", "devices": 1}))


def test_a_test_says_on_which_device_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert plp("fit", *tiny_smoke(tmp_path), "--trainer.accelerator", "cpu").code == 0
    run, asked, moved = smoke_run(tmp_path), list[Any](), list[Any]()
    real = nn.Module.to

    def resolved(settings: Mapping[str, Any]) -> torch.device:
        asked.append(settings["accelerator"])
        return resolved_device(settings)

    monkeypatch.setattr(assessment, "resolved_device", resolved)
    monkeypatch.setattr(
        nn.Module, "to", lambda self, *args, **kwargs: moved.append(args) or real(self, *args, **kwargs)
    )
    assert plp("test", run.path, "--episodes", 2).code == 0
    assert asked == ["cpu"]
    assert (CPU,) in moved
    assert json.loads((run.path / "test.json").read_text())["device"] == "cpu"


def test_who_asks_for_the_processor_is_not_warned_of_a_gpu() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quiet_lightning()
        warnings.warn("GPU available but not used. You can set it by `Trainer(accelerator='gpu')`.", stacklevel=1)
