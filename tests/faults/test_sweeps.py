"""Sweeps that cannot be: each is told in one line, before anything is written or run."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from command import ROOT, SMOKE, TINY, complaint, data_root, plp, tiny_smoke
from filelock import FileLock

from datamodules.plain_yaml import dump_yaml
from plp_lightning.sweeps import slurm

PAGE: dict[str, Any] = {"experiments": [["smoke", TINY[1]]], "targets": ["goal_3", "goal_6"]}


def page(folder: Path, **changes: Any) -> Path:
    path = folder / "mine.yaml"
    path.write_text(dump_yaml({**PAGE, "root": str(folder / "runs"), **changes}))
    return path


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"experiments": ["smok"]}, "experiments names 'smok', which is no page; did you mean 'smoke'?"),
        ({"experiments": ["base"]}, "experiments names 'base', which is no page"),
        ({"experiments": []}, "experiments is empty"),
        ({"experiments": ["smoke", "smoke"]}, "experiments names 'smoke' twice"),
        ({"experiments": [["smoke"], []]}, "experiments holds an empty list"),
        ({"methods": ["plpt"]}, "methods names 'plpt', which is no page; did you mean 'plp_t'?"),
        ({"methods": ["plp", "plp"]}, "methods names 'plp' twice"),
        ({"targets": ["goal_33"]}, "no target 'goal_33' in LinearPoint"),
        ({"targets": {"smokee": ["goal_3"]}}, "targets names experiment 'smokee', which experiments lacks"),
        ({"targets": []}, "targets is empty"),
        ({"seeds": []}, "seeds is empty"),
        ({"seeds": [0, 1, 0]}, "seeds names 0 twice"),
        ({"seeds": [-1]}, "expected a whole number from 0 to 4294967295"),
        ({"seeds": "many"}, "seeds"),
        ({"seed": [0]}, "did you mean 'seeds'?"),
        ({"overrides": {"a": {"alignment.epoch": 3}}}, "did you mean 'alignment.epochs'?"),
        ({"overrides": {"a": {"seed": 3}}}, "overrides.a sets seed, which comes from seeds"),
        ({"overrides": {"a": {"run_root": "x"}}}, "overrides.a sets run_root, which comes from root"),
        ({"overrides": {"../a": {"alignment.epochs": 3}}}, "method is 'plp_../a'"),
        ({"overrides": {}}, "overrides is empty"),
        ({"overrides": {"a": {}, "b": {}}}, "two runs share this directory"),
        ({"overrides": {"a": {"config": "nowhere"}}}, "nowhere: can't be read"),
        ({"overrides": {"a": {"config": 3}}}, "overrides.a.config is 3"),
        ({"parts": []}, "parts is []"),
        ({"parts": [3]}, "parts is [3]"),
        ({"parts": [{"root": "x"}]}, "a part sets root"),
        ({"parts": [{}, {"seeds": [0]}]}, "two runs share this directory"),
        ({"root": ""}, "root is empty"),
        ({"experiments": None}, "experiments not set"),
        ({"experiments": "smoke"}, "experiments is smoke; expected list"),
        ({"overrides": {"a": {"phase": "alignment"}}}, "sets phase, which comes from what runs have in common"),
        ({"parts": [{"parts": []}]}, "unknown key 'parts.parts'"),
    ],
)
def test_a_page_that_is_wrong_is_refused(changes: dict[str, Any], told: str, tmp_path: Path) -> None:
    for flags in (["--dry_run"], []):
        assert told in complaint("sweep", "--config", page(tmp_path, **changes), *flags)
    assert {file.name for file in tmp_path.iterdir()} == {"mine.yaml"}


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (["--only", "r2r/*"], "matches none of 2 runs, such as 'smoke/plp/goal_3/seed_0'"),
        (["--seed", "3"], "--seed comes from seeds of the sweep's page"),
        (["--data.target_task=goal_1"], "--data.target_task comes from targets"),
        (["--run_root", "x"], "--run_root comes from root"),
        (["--phase", "alignment"], "--phase comes from what runs have in common; leave it away"),
        (["--print_config"], "--print_config comes from plp fit alone; leave it away"),
        (["--jobs", "0"], "found '0'; expected a whole number of at least 1"),
        (["--retries", "-1"], "expected"),
        (["--engine", "pbs"], "invalid choice: 'pbs'"),
        (["--job", "3"], "unknown key 'job'"),
        (["--config", "smoke"], "--config is given 2 times"),
        (["--root", ""], "root is empty"),
    ],
)
def test_options_that_are_wrong_are_refused(flags: list[str], told: str, tmp_path: Path) -> None:
    assert told in complaint("sweep", "--config", page(tmp_path), *flags)
    assert not (tmp_path / "runs").exists()


def test_what_is_null_has_its_default(tmp_path: Path) -> None:
    nothing = dict.fromkeys(("methods", "targets", "seeds", "overrides"))
    told = plp("sweep", "--config", page(tmp_path, **nothing), "--dry_run")
    assert "1 runs: 0 done, 0 begun, 1 to begin" in told.out


def test_an_experiment_is_no_sweep() -> None:
    assert "unknown key 'domains'" in complaint("sweep", *SMOKE)


def test_gpus_are_asked_for_where_there_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert "--per_gpu: no GPU is to be seen here" in complaint("sweep", "--config", page(tmp_path), "--per_gpu", 2)


@pytest.mark.parametrize("name", ["runs", "above/runs"])
def test_a_root_that_is_a_file_or_below_one(name: str, tmp_path: Path) -> None:
    (tmp_path / name.split("/")[0]).write_text("")
    told = complaint("sweep", "--config", page(tmp_path, root=str(tmp_path / name)))
    assert "expected a place that can be read and written" in told or "is no folder" in told


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_a_root_that_may_not_be_written(tmp_path: Path) -> None:
    (tmp_path / "closed").mkdir(mode=0o500)
    told = complaint("sweep", "--config", page(tmp_path, root=str(tmp_path / "closed" / "runs")))
    assert "expected a place that can be read and written" in told


def test_two_sweeps_on_one_root(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with FileLock(tmp_path / "runs" / ".sweep.lock"):
        told = complaint("sweep", "--config", page(tmp_path))
        assert "another sweep works here; wait for it, stop it, or name another --root" in told
        assert plp("sweep", "--config", page(tmp_path), "--dry_run").code == 0


@pytest.mark.parametrize("lacking", ["submitit", "sbatch", "squeue"])
def test_slurm_that_is_not_here(lacking: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slurm, "find_spec", lambda name: None if name == lacking else object())
    monkeypatch.setattr(shutil, "which", lambda name: None if name == lacking else name)
    told = complaint("sweep", "--config", page(tmp_path), "--engine", "slurm")
    assert f"--engine slurm needs {lacking}, which is not" in told
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("word", ["partition", "=gpu", "time="])
def test_slurm_options_that_are_no_pairs(word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slurm, "find_spec", lambda name: object())
    monkeypatch.setattr(shutil, "which", lambda name: name)
    told = complaint("sweep", "--config", page(tmp_path), "--engine", "slurm", "--slurm", word)
    assert "expected NAME=VALUE" in told


def test_settings_that_have_changed_since_are_told(tmp_path: Path) -> None:
    assert plp("fit", *tiny_smoke(tmp_path / "runs"), "--alignment.epochs", 1).code == 0
    flags = ["--data.root", data_root(), "--score.samples", 50]
    for more in (["--dry_run"], []):
        told = complaint("sweep", "--config", page(tmp_path), *flags, *more)
        assert "smoke/plp/goal_3/seed_0: alignment.init_args.epochs has changed since the run began" in told
    assert plp("sweep", "--config", page(tmp_path), *flags, "--dry_run", "--root", tmp_path / "other").code == 0
    told = plp("sweep", "--config", page(tmp_path), *flags, "--dry_run", "--alignment.epochs", 1).out
    assert "2 runs: 1 done, 0 begun, 1 to begin" in told


@pytest.mark.parametrize("content", ["{", "[]", json.dumps({"state": "odd"})])
def test_a_run_whose_record_is_damaged_is_told(content: str, tmp_path: Path) -> None:
    run = tmp_path / "runs" / "smoke" / "plp" / "goal_3" / "seed_0"
    run.mkdir(parents=True)
    shutil.copy(ROOT / "configs" / "smoke.yaml", run / "config.yaml")
    (run / "status.json").write_text(content)
    assert f"{run / 'status.json'}: " in complaint("sweep", "--config", page(tmp_path))
