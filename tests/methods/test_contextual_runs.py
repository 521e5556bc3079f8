"""Runs of the contextual policy through the command line: one phase, trials in the target domain alone."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import yaml
from command import ROOT, checkpoint, dies, plp, results, same, smoke_run, tiny_smoke

from plp_lightning.cli.config import parse
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

OVERLAY = ["--config", str(ROOT / "configs" / "methods" / "contextual.yaml")]
PAPER = ["--config", str(ROOT / "configs" / "studies" / "contextual_paper.yaml")]
FEW = ["--policy.feed_forward", "32", "--policy.heads", "4", "--alignment.epochs", "2", "--data.pairs", "2"]
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"


def words(run_root: Path) -> list[str]:
    return [*tiny_smoke(run_root), *OVERLAY, *FEW]


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("contextual")
    answer = plp("fit", *words(root))
    assert answer.code == 0, answer
    assert "target task in target domain" in answer.out
    assert "in source domain" not in answer.out
    return smoke_run(root, "contextual")


@pytest.mark.parametrize(("study", "epochs", "pairs"), [([], 64, 8), (PAPER, 500, 64)], ids=["default", "paper"])
def test_its_own_settings_win_over_the_page(study: list[str], epochs: int, pairs: int) -> None:
    experiment = parse([*tiny_smoke(Path())[:2], *OVERLAY, *study])
    settings = yaml.safe_load(experiment.config)
    assert experiment.data.batching.pairs == pairs
    assert list(experiment.method.phases) == ["alignment"]
    assert "adaptation" not in settings
    assert settings["alignment"]["init_args"]["epochs"] == epochs
    assert settings["alignment"]["init_args"]["optimizer"]["init_args"]["lr"] == 1e-3


def test_a_run_is_evaluated_in_the_target_domain_alone(unbroken: RunDirectory) -> None:
    found = json.loads(unbroken.results.read_text())
    assert {trial: found[trial]["episodes"] for trial in ("target", "proxy")} == {"target": 4, "proxy": 4}
    assert not {"source", "proxy_source"} & found.keys()
    assert found["phases"] == ["alignment"]
    logged = {metric for _, metric, _ in read_rows(unbroken.phase("alignment") / "metrics.csv")}
    assert {"train/bc", "val/bc", "val/bc_tall", "final/target_success"} <= logged
    assert checkpoint(unbroken, "alignment", "best")["state_dict"].keys()


def test_a_run_can_be_looked_at_again(unbroken: RunDirectory, tmp_path: Path) -> None:
    answer = plp("test", unbroken.path, "--output", tmp_path / "test.json")
    assert answer.code == 0, answer
    told, found = json.loads((tmp_path / "test.json").read_text()), json.loads(unbroken.results.read_text())
    for trial in ("target", "proxy"):
        assert {**told["trials"][trial], "before": None} == found[trial]
    assert "val/bc_tall: " in plp("validate", unbroken.path).out
    assert "steps of tall" in plp("predict", unbroken.path, "--output", tmp_path / "p.npz").out


@pytest.mark.parametrize("step", [3, 8])
def test_a_killed_run_resumes_to_the_same_weights(step: int, unbroken: RunDirectory, tmp_path: Path) -> None:
    assert dies(["fit", *words(tmp_path)], STEP, step, signal.SIGKILL) == -signal.SIGKILL
    run = smoke_run(tmp_path, "contextual")
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    for which in ("last", "best"):
        ours, theirs = (checkpoint(r, "alignment", which) for r in (run, unbroken))
        assert same(ours["state_dict"], theirs["state_dict"]), which
        assert same(ours["optimizer_states"], theirs["optimizer_states"]), which
    assert results(run) == results(unbroken)
