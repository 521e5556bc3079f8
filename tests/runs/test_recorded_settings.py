"""What results were made with: the settings that differ from the defaults, a hash of all, and the code."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from command import METHODS, ROOT, SMOKE, plp, smoke_run, tiny_smoke
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2

from plp_lightning.cli.config import parse
from plp_lightning.runs.results import print_success
from plp_lightning.runs.settings import config_hash, differing_settings


def resolved(*words: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(parse([*SMOKE, *words]).config)
    return found


def test_what_a_file_or_flag_sets_is_listed_and_nothing_else() -> None:
    plain = differing_settings(resolved())
    assert plain["policy"] == "PortablePolicy"
    assert (plain["alignment.optimizer.lr"], plain["data.trajectories"]) == (2e-3, 140)
    assert plain["domains.tall.simulator.map_seed"] == 2  # required, so always told
    assert plain["score.0.samples"] == 200
    assert not {"alignment.optimizer.weight_decay", "data.val_fraction", "domains.tall.expert.gain"} & plain.keys()
    assert not {"seed", "method", "experiment", "data.target_task", "run_root"} & plain.keys()

    flags = ["--alignment.optimizer.weight_decay", "0.5", "--data.val_fraction", "0.2", "--evaluation.films", "0"]
    changed = differing_settings(resolved(*flags, "--policy.encoder_layers", "3", "--seed", "4", "--run_root", "x"))
    extra = {"alignment.optimizer.weight_decay": 0.5, "data.val_fraction": 0.2, "evaluation.films": 0}
    assert changed == plain | extra  # three layers are the default


def test_every_value_that_differs_from_its_class_s_default_is_one_that_is_listed() -> None:
    tree = resolved("--config", str(ROOT / "configs" / "methods" / "cdil.yaml"))
    listed = differing_settings(tree)
    tree["alignment"]["init_args"]["noise"] = 0.7
    tree["alignment"]["init_args"].pop("discriminator_layers")  # of an older release, say
    assert differing_settings(tree) == listed | {"alignment.noise": 0.7}


def test_a_class_that_is_gone_has_all_its_settings_listed() -> None:
    tree = {"policy": {"class_path": "plp_lightning.methods.Gone", "init_args": {"hidden": 3}}, "data": {"pairs": 32}}
    assert differing_settings(tree) == {"policy": "Gone", "policy.hidden": 3}


def test_the_hash_tells_settings_but_not_places(tmp_path: Path) -> None:
    one = config_hash(resolved())
    assert one == config_hash(resolved("--run_root", "x", "--data.root", "y", "--data.file", "z.hdf5"))
    others = [resolved("--seed", "1"), resolved("--data.pairs", "9"), resolved("--alignment.optimizer.lr", "0.1")]
    assert len({one, *map(config_hash, others)}) == 4


@pytest.mark.parametrize("method", METHODS, ids=lambda path: path.stem)
def test_settings_of_every_method_are_plain_and_of_one_level(method: Path) -> None:
    settings = differing_settings(resolved("--config", str(method)))
    assert json.loads(json.dumps(settings)) == settings
    assert not any(isinstance(value, dict) for value in settings.values())
    assert not any("init_args" in key or "class_path" in key for key in settings)


def test_results_and_tensorboard_tell_what_they_were_made_with(tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), "--trainer.accelerator", "cpu", "--seed", "3")
    assert answer.code == 0, answer
    run = smoke_run(tmp_path, seed=3)
    found = json.loads(run.results.read_text())
    config = yaml.safe_load(run.config.read_text())
    assert found["settings"] == differing_settings(config)
    assert found["config_sha256"] == config_hash(config)
    assert found["device"] == "cpu"
    assert found["version"] == found["versions"].get("plp-lightning")
    assert found["commit"] is None or len(found["commit"].removesuffix("-dirty")) == 40

    events = EventAccumulator(str(run.phase("adaptation")))
    events.Reload()
    plugin = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    row = plugin_data_pb2.HParamsPluginData.FromString(plugin).session_start_info.hparams
    assert (row["method"].string_value, row["seed"].number_value) == ("plp", 3)
    assert (row["target_task"].string_value, row["alignment.optimizer.lr"].number_value) == ("goal_3", 2e-3)
    assert "alignment.optimizer.weight_decay" in row  # all others come after


def told(folder: Path) -> str:
    """The commit, asked in a process that imports the package from ``folder``."""
    code = "from plp_lightning.runs.versions import commit; print(commit())"
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def git(folder: Path, *words: str) -> str:
    names = {
        f"GIT_{who}_{what}": "someone@example.com" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
    }
    command = ["git", "-C", str(folder), *words]
    return subprocess.run(command, env=os.environ | names, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_commit_is_that_of_the_checkout_that_was_imported(tmp_path: Path) -> None:
    package = tmp_path / "plp_lightning" / "runs"
    package.mkdir(parents=True)
    shutil.copy(ROOT / "plp_lightning" / "runs" / "versions.py", package)
    for name in (package.parent, package):
        (name / "__init__.py").touch()
    assert told(tmp_path) == "None"  # no checkout at all
    git(tmp_path, "init", "-q")
    (tmp_path / "other.txt").write_text("of another project\n")
    git(tmp_path, "add", "other.txt")
    git(tmp_path, "commit", "-qm", "another project")
    assert told(tmp_path) == "None"  # installed below a checkout that it is no part of
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "ours")
    assert told(tmp_path) == git(tmp_path, "rev-parse", "HEAD")
    (tmp_path / "other.txt").write_text("changed\n")
    assert told(tmp_path) == git(tmp_path, "rev-parse", "HEAD") + "-dirty"


def test_without_git_there_is_no_commit(tmp_path: Path) -> None:
    code = "from plp_lightning.runs.versions import commit; print(commit())"
    nowhere = os.environ | {"PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=nowhere, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "None"


def test_further_measures_of_an_outcome_are_columns_of_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    counts = {"success": 0.5, "interval": [0.25, 0.75], "episodes": 4, "invalid": 0}
    print_success({"target": {**counts, "steps_to_success": 12.5}, "proxy": counts}, "title")
    printed = capsys.readouterr().out
    assert "12.50" in next(line for line in printed.splitlines() if "target task in target domain" in line)
    assert next(line for line in printed.splitlines() if "proxy tasks in target domain" in line).count("–") == 3
