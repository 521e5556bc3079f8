"""The examples under docs/ are as short as they say and do what they say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from command import ROOT, TINY, plp, smoke_run, tiny_smoke

from plp_lightning.runs.directory import RunDirectory

EXAMPLES = ROOT / "docs" / "examples"
PAGE = EXAMPLES / "valley_car.yaml"


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Options of a miniature run of the example."""
    monkeypatch.syspath_prepend(EXAMPLES)
    tiny = yaml.safe_load(Path(TINY[1]).read_text())
    del tiny["score"]
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(tiny))
    roots = ["--data.root", str(tmp_path / "data"), "--run_root", str(tmp_path / "runs")]
    return ["--config", str(PAGE), "--config", str(tmp_path / "tiny.yaml"), *roots, "--allow_imports", "valley_car"]


def test_a_simulator_with_its_expert_takes_fifty_lines() -> None:
    assert len((EXAMPLES / "valley_car.py").read_text().splitlines()) <= 50


def test_a_simulator_of_ones_own_collects_trains_and_tests(words: list[str], tmp_path: Path) -> None:
    fitted = plp("fit", *words)
    assert fitted.code == 0, fitted
    run = RunDirectory(tmp_path / "runs" / "valley_car" / "plp" / "right" / "seed_0")
    results = json.loads(run.results.read_text())
    tested = plp("test", run.path, "--allow_imports", "valley_car")
    assert tested.code == 0, tested
    trials = json.loads((run.path / "test.json").read_text())["trials"]
    assert {name: trials[name]["success"] for name in trials} == {name: results[name]["success"] for name in trials}
    assert {"target", "source", "proxy", "proxy_source"} == trials.keys()


def test_without_an_expert_its_demonstrations_come_from_a_file(words: list[str]) -> None:
    experts = [f"--domains.{domain}.expert=null" for domain in ("car", "mirrored")]
    refused = plp("fit", *words, *experts)
    assert refused.code == 2
    assert "has no expert; add one or import demonstrations into" in refused.err
    collected = plp("collect", *words)
    assert collected.code == 0, collected
    fitted = plp("fit", *words, *experts, "--method", "from_file")
    assert fitted.code == 0, fitted


def test_a_metric_of_ones_own_takes_a_class_and_an_overlay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    overlay = ["--config", str(EXAMPLES / "action_change.yaml"), "--allow_imports", "action_change"]
    answer = plp("fit", *tiny_smoke(tmp_path), *overlay, "--evaluation.every_n_epochs", "{alignment: 1}")
    assert answer.code == 0, answer
    run = smoke_run(tmp_path)
    results = json.loads(run.results.read_text())
    assert "action change" in answer.out
    for trial in ("target", "source", "proxy", "proxy_source"):
        assert results[trial]["action_change"] > 0
    assert "eval/target_action_change" in (run.phase("alignment") / "metrics.csv").read_text()
    tested = plp("test", run.path, "--allow_imports", "action_change")
    assert tested.code == 0, tested
    again = json.loads((run.path / "test.json").read_text())["trials"]
    assert again["target"]["action_change"] == results["target"]["action_change"]
    metrics = yaml.safe_load(run.config.read_text())["evaluation"]["metrics"]
    assert [metric["class_path"].rpartition(".")[2] for metric in metrics] == ["StepsToSuccess", "ActionChange"]
