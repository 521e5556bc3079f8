"""Experiments whose domains are known by their demonstrations alone."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
import yaml
from command import ROOT, SMOKE, checkpoint, complaint, data_root, dies, plp, results, same, smoke_run

import plp_lightning
from datamodules.store.writer import write_trajectories
from datamodules.types import Observation
from plp_lightning.cli.config import parse
from plp_lightning.runs.directory import RunDirectory

LITTLE = ["--config", str(ROOT / "tests" / "conf" / "tiny.yaml")]


def page(demonstrations: Path, folder: Path, **data: Any) -> list[str]:
    """Options of a tiny run on a file's two domains, from ``flat`` to ``tall``."""
    told: dict[str, Any] = {"source_domain": "flat", "target_domain": "tall", "target_task": "goal_3"}
    told["file"] = str(demonstrations)
    told |= data
    config = {"experiment": "own", "domains": {"flat": {}, "tall": {}}, "data": told}
    (folder / "own.yaml").write_text(yaml.safe_dump(config))
    return [*LITTLE, "--config", str(folder / "own.yaml"), "--run_root", str(folder / "runs")]


def own_run(folder: Path, task: str = "goal_3") -> RunDirectory:
    return RunDirectory(folder / "runs" / "own" / "plp" / task / "seed_0")


@pytest.mark.parametrize("method", ["plp_t", "bc"])
def test_weights_are_those_of_the_same_experiment_with_simulators(method: str, tmp_path: Path) -> None:
    overlay = ["--config", str(ROOT / "configs" / "methods" / f"{method}.yaml"), "--score", "[NeighbourhoodScore]"]
    smoke = yaml.safe_load((ROOT / "configs" / "smoke.yaml").read_text())
    smoke.pop("score")
    (tmp_path / "smoke.yaml").write_text(yaml.safe_dump({**smoke, "domains": {"flat": {}, "tall": {}}}))
    roots = ["--data.root", str(data_root())]
    with_simulators = [*SMOKE, *LITTLE, *overlay, *roots, "--run_root", tmp_path / "with"]
    without = ["--config", tmp_path / "smoke.yaml", *LITTLE, *overlay, *roots, "--run_root", tmp_path / "without"]
    for words in (with_simulators, without):
        answer = plp("fit", *words)
        assert answer.code == 0, answer
    assert "success: not simulated, as no domain has a simulator" in answer.out
    one, other = smoke_run(tmp_path / "with", method), smoke_run(tmp_path / "without", method)
    for phase in one.status()["phases"]:
        assert same(checkpoint(one, phase)["state_dict"], checkpoint(other, phase)["state_dict"])
    assert results(one)["held_out"] == results(other)["held_out"]
    assert results(one)["alignment"] == results(other)["alignment"]
    assert "target" in results(one)
    assert "target" not in results(other)


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three tasks, one of which the target domain lacks; unequal numbers; the target shown everywhere."""
    kept = {("flat", "goal_0"): 4, ("tall", "goal_0"): 2, ("flat", "goal_1"): 3, ("tall", "goal_1"): 4}
    kept |= {("flat", "goal_2"): 4, ("flat", "goal_3"): 2, ("tall", "goal_3"): 4}
    path = tmp_path_factory.mktemp("uneven") / "uneven.hdf5"
    specs = [domain.world.spec(name) for name, domain in tiny.domains().items()]
    by_pair: dict[tuple[str, str], list[Any]] = {pair: [] for pair in kept}
    for made in tiny.demonstrations(4):
        by_pair.get((made.domain, made.task), []).append(made)
    chosen = [made for pair, found in by_pair.items() for made in found[: kept[pair]]]
    write_trajectories(path, specs, ("goal_0", "goal_1", "goal_2", "goal_3"), chosen, {})
    return path


ALL = {"data.trajectories": None, "data.target_trajectories": None}


def all_there_are(words: list[str]) -> list[str]:
    return [*words, *(word for key in ALL for word in (f"--{key}", "null"))]


def test_all_there_are_is_used_and_what_is_left_out_is_told(uneven: Path, tmp_path: Path) -> None:
    answer = plp("fit", *all_there_are(page(uneven, tmp_path)))
    assert answer.code == 0, answer
    assert f"task 'goal_2' is left out: {uneven} shows none of it in domain 'tall'" in answer.err
    data = parse(all_there_are(page(uneven, tmp_path))).data
    assert data.proxy_tasks == ("goal_0", "goal_1")
    shown = {d: {data.tasks[t] for t in dataset.episode_task} for d, dataset in data.datasets.items()}
    # The target task in the target domain is in the file, and is never read.
    assert shown == {"flat": {"goal_0", "goal_1", "goal_3"}, "tall": {"goal_0", "goal_1"}}
    assert [len(dataset.episode_task) for dataset in data.datasets.values()] == [4 + 3 + 2, 2 + 4]


def test_proxy_tasks_can_be_named(uneven: Path, tmp_path: Path) -> None:
    assert parse(all_there_are(page(uneven, tmp_path, proxy_tasks=["goal_1"]))).data.proxy_tasks == ("goal_1",)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"proxy_tasks": ["goal_9"]}, "names 'goal_9'; the tasks are goal_0, goal_1, goal_2, goal_3"),
        ({"proxy_tasks": ["goal_3"]}, "names 'goal_3', the target"),
        ({"proxy_tasks": []}, "--data.proxy_tasks is empty"),
        ({"proxy_goals": 2}, "name the tasks"),
        ({"target_task": "goal_9"}, "no demonstration of 'goal_9', the target task, in source domain 'flat'"),
        ({"target_domain": "round"}, "--data.target_domain is 'round'"),
        ({"file": "none.hdf5"}, "none.hdf5: no such file"),
        ({"proxy_tasks": ["goal_2"], "trajectories": None}, "domain 'tall'"),
        ({"trajectories": 100}, "demonstrations are missing"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_told(data: dict[str, Any], told: str, uneven: Path, tmp_path: Path) -> None:
    words = page(uneven, tmp_path, **data)
    words += [] if data.get("trajectories") else ["--data.trajectories", "null"]
    assert told in complaint("fit", *words, "--data.target_trajectories", "null")
    assert not (tmp_path / "runs").exists()


def test_a_domain_that_the_file_lacks_is_told(uneven: Path, tmp_path: Path) -> None:
    words = page(uneven, tmp_path)
    (tmp_path / "own.yaml").write_text((tmp_path / "own.yaml").read_text().replace("tall", "round"))
    assert "holds domains flat, tall, not 'round'" in complaint("fit", *words)


def test_scores_that_ask_simulators_are_refused(uneven: Path, tmp_path: Path) -> None:
    told = complaint("fit", *all_there_are(page(uneven, tmp_path)), "--score", "[ClosenessScore]")
    assert "score ClosenessScore asks simulators, and domain 'flat' has none" in told


def test_a_run_is_resumed_looked_at_and_leaves(uneven: Path, tmp_path: Path) -> None:
    words = ["fit", *all_there_are(page(uneven, tmp_path)), "--score", "[NeighbourhoodScore]"]
    assert dies(words, "plp_lightning.runs.fit:assess", 2, signal.SIGKILL) == -signal.SIGKILL
    run = own_run(tmp_path)
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    assert 0 <= json.loads(run.results.read_text())["alignment"]["mix"] <= 1
    assert "acts in no domain that has a simulator" in complaint("test", run.path)
    assert "domain 'tall' is known by its demonstrations alone" in complaint("rollout", run.path)
    for verb in ("validate", "predict"):
        assert plp(verb, run.path).code == 0
    assert "| own | plp | 1 | not simulated |" in plp("report", run.path).out
    state = np.zeros((3, 5), np.float32)
    assert plp_lightning.load_policy(run.path).act(Observation(state), "tall", "goal_3").shape == (3, 2)
