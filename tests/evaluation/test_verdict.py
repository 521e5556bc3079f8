"""The verdict names what falls short, and nothing else; its facts are those of the policy and its demonstrations."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from command import ROOT
from tiny import data_module
from tiny import policy as portable_policy

from datamodules.transfer import TransferDataModule
from plp_lightning.evaluation.held_out import held_out_actions
from plp_lightning.evaluation.verdict import CHECKS, facts, shortfalls, verdict

WELL = {"cloned/a": 1.0, "cloned/b": 0.9, "learnt": 1.0, "mix": 0.45, "spread": 0.1, "proxies": 8.0}


@pytest.fixture
def data(trajectory_file: Path) -> TransferDataModule:
    return data_module(trajectory_file)


def test_what_is_well_is_aligned() -> None:
    assert verdict(WELL) == ["verdict: aligned"]


@pytest.mark.parametrize(
    ("fact", "value", "told"),
    [
        ("cloned/b", 0.31, "success on proxy tasks in b is 0.31, expected at least 0.8: "),
        ("unexplained/a", 0.4, "share of held-out actions that is not explained in a is 0.40, expected at most 0.1: "),
        ("mix", 0.08, "is 0.08, expected at least 0.3: the domains lie apart in the latent space; "),
        ("spread", 0.0001, "have shrunk to a point"),
        ("learnt", 0.2, "--adaptation.epochs"),
        ("proxies", 2.0, "--data.proxy_tasks"),
    ],
)
def test_what_falls_short_is_named_with_what_to_try(fact: str, value: float, told: str) -> None:
    known = WELL | {fact: value}
    assert [name for name, _ in shortfalls(known)] == [fact]
    head, line = verdict(known)
    assert head == "verdict: falls short (docs/verdict.md)"
    assert told in line
    assert "; try " in line


def test_a_method_without_a_latent_space_is_not_called_aligned() -> None:
    known = {name: value for name, value in WELL.items() if name not in ("mix", "spread")}
    assert verdict(known) == ["verdict: nothing falls short; this method has no latent space that all domains share"]


def test_facts_of_latents_are_those_of_the_policy(data: TransferDataModule) -> None:
    policy = portable_policy(data)
    known = facts(policy, data, {"proxy": 0.5, "proxy_source": 0.75, "target": 0.125}, held_out_actions(policy, data))
    assert (known["cloned/flat"], known["cloned/tall"]) == (0.75, 0.5)
    assert "learnt" not in known  # the target task in the target domain says nothing here
    assert not any(name.startswith("unexplained") for name in known)
    assert known["mix"] < 0.1  # an untrained encoder keeps the domains apart
    apart = policy.encode
    policy.encode = lambda seen: {d: x * 1e-4 for d, x in apart(seen).items()}  # type: ignore[method-assign]
    shrunk = facts(policy, data, {}, held_out_actions(policy, data))
    assert shrunk["spread"] == pytest.approx(1e-4 * known["spread"], rel=1e-3)
    assert shrunk["mix"] == pytest.approx(known["mix"], abs=0.02)


def test_without_simulators_the_share_of_unexplained_actions_counts(data: TransferDataModule) -> None:
    policy = portable_policy(data)
    known = facts(policy, data, {}, held_out_actions(policy, data))
    assert set(known) >= {"unexplained/flat", "unexplained/tall"}
    assert known["unexplained/tall"] > 0.5  # untrained

    def told(seen: object, task: object) -> dict[str, torch.Tensor]:
        (domain,) = seen  # type: ignore[misc, attr-defined]
        rows = torch.from_numpy(data.rows([*data.proxy_tasks, *data.target_tasks], "val")[domain])
        return {domain: data.datasets[domain].action[rows]}

    policy.predict_actions = told  # type: ignore[method-assign, assignment]
    assert facts(policy, data, {}, held_out_actions(policy, data))["unexplained/tall"] == 0


def test_the_page_explains_each_check() -> None:
    page = (ROOT / "docs" / "verdict.md").read_text()
    assert [check.fact for check in CHECKS if f"## `{check.fact}`" not in page] == []
