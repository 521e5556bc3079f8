"""The examples under docs/ are as short as they say and do what they say."""

from __future__ import annotations

import doctest
import importlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from command import ROOT, TINY, plp, smoke_run, tiny_smoke

import plp_lightning
from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs import Gymnasium
from plp_lightning.envs.rollout import rollout
from plp_lightning.runs.directory import RunDirectory

EXAMPLES = ROOT / "docs" / "examples"
PAGE = EXAMPLES / "valley_car.yaml"


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Options of a miniature run of the example."""
    monkeypatch.syspath_prepend(EXAMPLES)
    tiny = yaml.safe_load(Path(TINY[1]).read_text())
    tiny.pop("score", None)
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


def test_fetch_in_two_frames_is_trained_on_and_tested_by_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    assert len((EXAMPLES / "fetch.yaml").read_text().splitlines()) <= 40
    words = ["--config", EXAMPLES / "fetch.yaml", "--config", ROOT / "tests" / "conf" / "tiny.yaml"]
    roots = ["--data.root", tmp_path, "--run_root", tmp_path, "--allow_imports", "fetch"]
    alone = [f"--domains.{domain}.simulator.threads=1" for domain in ("fetch", "turned")]
    answer = plp("fit", *words, *roots, *alone, "--evaluation.final_episodes", "2")
    assert answer.code == 0, answer
    results = json.loads((tmp_path / "fetch" / "plp" / "far_left" / "seed_0" / "results.json").read_text())
    assert (results["target"]["episodes"], results["target"]["invalid"]) == (2, 0)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_fetchs_expert_reaches_all_places_in_each_frame(turns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    fetch = importlib.import_module("fetch")
    names, make = [*fetch.PLACES][turns::3], {"turns": turns, "unit": 10.0**turns}
    simulator = Gymnasium("fetch:Fetch", names, make, keys=["place", "velocity"], horizon=30, threads=1)
    expert = fetch.FetchExpert()
    expert.begin(simulator, names, range(len(names)))
    assert rollout(simulator, expert.act, names, range(len(names))).success.all()


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
    curves = (run.phase("alignment") / "metrics.csv").read_text()
    assert "eval/target_action_change" in curves
    assert "final/target_action_change" in curves
    tested = plp("test", run.path, "--allow_imports", "action_change")
    assert tested.code == 0, tested
    again = json.loads((run.path / "test.json").read_text())["trials"]
    assert again["target"]["action_change"] == results["target"]["action_change"]
    metrics = yaml.safe_load(run.config.read_text())["evaluation"]["metrics"]
    assert [metric["class_path"].rpartition(".")[2] for metric in metrics] == ["StepsToSuccess", "ActionChange"]


@pytest.mark.parametrize(
    ("name", "most"), [("coral", 60), ("neighbours", 45), ("action_change", 30), ("linear", 100), ("patches", 50)]
)
def test_an_extension_takes_two_files(name: str, most: int) -> None:
    files = sorted(EXAMPLES.glob(f"{name}.*"))
    assert [file.suffix for file in files] == [".py", ".yaml"]
    assert len(files[0].read_text().splitlines()) <= most


@pytest.mark.parametrize("name", ["coral", "neighbours", "linear"])
def test_an_extension_trains_tests_and_is_loaded(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    trusted = ["--allow_imports", name]
    answer = plp("fit", *tiny_smoke(tmp_path), "--config", str(EXAMPLES / f"{name}.yaml"), *trusted)
    assert answer.code == 0, answer
    run = smoke_run(tmp_path, name if name != "neighbours" else "plp")
    curves = (run.phase("alignment") / "metrics.csv").read_text()
    results = json.loads(run.results.read_text())
    if name == "coral":
        assert "train/coral" in curves
        assert "train/mmd" not in curves
    if name == "neighbours":
        assert {*results["alignment"]} == {"closeness", "neighbour_mix"}
        assert 0 <= results["alignment"]["neighbour_mix"] <= 1
        assert "alignment/neighbour_mix" in curves
    tested = plp("test", run.path, *trusted)
    assert tested.code == 0, tested
    policy = plp_lightning.load_policy(run.path, allow_imports=trusted[1:])
    action = policy.act(Observation(np.zeros((3, 7), np.float32)), domain="tall", task="goal_1")
    assert action.shape == (3, 2)


def test_an_image_encoder_of_ones_own_is_laid_over_a_page_with_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    pages = ["--config", ROOT / "tests" / "conf" / "seen.yaml", *TINY, "--config", EXAMPLES / "patches.yaml"]
    words = [*pages, "--data.root", tmp_path, "--run_root", tmp_path / "runs", "--allow_imports", "patches"]
    answer = plp("fit", *words)
    assert answer.code == 0, answer
    run = RunDirectory(tmp_path / "runs" / "seen" / "patches" / "blue" / "seed_0")
    assert "train/reconstruction" in (run.phase("alignment") / "metrics.csv").read_text()
    policy = plp_lightning.load_policy(run.path, allow_imports=["patches"])
    observation = Observation(np.zeros((3, 5), np.float32), {"camera": np.zeros((3, 16, 16, 3), np.uint8)})
    assert policy.act(observation, domain="right", task="red").shape == (3, 2)


def test_a_policy_of_a_package_that_is_not_trusted_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    words = ["--config", str(EXAMPLES / "linear.yaml"), "--allow_imports", "linear", "--trainer.max_epochs", "1"]
    assert plp("fit", *tiny_smoke(tmp_path), *words).code == 0
    with pytest.raises(ConfigError, match=r"importing 'linear.LinearPolicy' is not allowed; .* --allow_imports linear"):
        plp_lightning.load_policy(smoke_run(tmp_path, "linear").path)


def test_what_contributors_read_names_every_example() -> None:
    told = (ROOT / "CONTRIBUTING.md").read_text() + (EXAMPLES / "README.md").read_text()
    assert not [file.name for file in EXAMPLES.glob("*.py") if file.name not in told]


def test_the_functions_of_examples_are_true(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    outcome = doctest.testmod(importlib.import_module("coral"), extraglobs={"torch": torch})
    assert (outcome.attempted, outcome.failed) == (1, 0)
