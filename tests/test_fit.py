"""``plp fit`` from the first demonstration to the result table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from command import METHODS, SMOKE, checkpoint, data_root, plp, smoke_run, tiny_smoke
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

PHASES = ("alignment", "adaptation")
TRIALS = ("target", "source", "proxy", "proxy_source")
TERMS = {"tcc": "train/tcc", "mmd": "train/mmd", "adversarial": "train/discriminator"}


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A miniature run that also draws its latent space."""
    root = tmp_path_factory.mktemp("pictured")
    answer = plp("fit", *tiny_smoke(root), "--evaluation.latent_states", "20")
    assert answer.code == 0, answer
    return smoke_run(root)


def is_plp(overlay: Path) -> bool:
    """Whether a method is PLP with other terms or inputs; the others have tests of their own."""
    return "class_path" not in yaml.safe_load(overlay.read_text()).get("policy", {})


@pytest.mark.parametrize("overlay", [path for path in METHODS if is_plp(path)], ids=lambda path: path.stem)
def test_plp_runs_the_whole_chain_with_any_terms(overlay: Path, tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), "--config", overlay)
    assert answer.code == 0, answer
    assert answer.err == ""
    run = smoke_run(tmp_path, overlay.stem)
    results = json.loads(run.results.read_text())
    assert [results[key] for key in ("experiment", "method", "target_task", "seed")] == [
        "smoke",
        overlay.stem,
        "goal_3",
        0,
    ]
    for trial in TRIALS:
        outcome = results[trial]
        assert set(outcome) == {"success", "before", "episodes", "invalid", "interval"}
        low, high = outcome["interval"]
        assert 0 <= low <= outcome["success"] <= high <= 1
        assert (outcome["episodes"], outcome["invalid"]) == (4, 0)
    assert 0 <= results["alignment"]["closeness"] <= 1
    assert set(results["seconds"]) == {"collection", *PHASES}
    assert {"torch", "lightning", "python"} <= set(results["versions"])
    for phase in PHASES:
        for which in ("best", "last"):
            assert {"policy", "state_dict", "optimizer_states", "loops"} <= checkpoint(run, phase, which).keys()
    logged = {metric for _, metric, _ in read_rows(run.phase("alignment") / "metrics.csv")}
    terms = {"mmd": True, **yaml.safe_load(overlay.read_text())["alignment"]["init_args"]["terms"]}
    assert {"train/bc", "val/bc"} <= logged
    assert {name for name in TERMS.values() if name in logged} == {TERMS[name] for name, term in terms.items() if term}


def test_curves_settings_and_picture_are_in_tensorboard(pictured: RunDirectory) -> None:
    for phase in PHASES:
        events = EventAccumulator(str(pictured.phase(phase)))
        events.Reload()
        scalars = set(events.Tags()["scalars"])
        assert {"loss/train/bc", "loss/held_out/bc", "loss/held_out/bc_flat"} <= scalars
        assert {"alignment/closeness", "final/target_success", "speed/steps_per_second"} <= scalars
        assert events.Tags()["images"] == [f"{phase}/latents", f"{phase}/neighbours"]
        assert ("_hparams_/session_start_info" in events.summary_metadata) == (phase == PHASES[-1])  # a row a run
        assert (pictured.phase(phase) / "latents.png").stat().st_size > 0


def test_run_directory_tells_what_was_run(pictured: RunDirectory) -> None:
    status = pictured.status()
    assert (status["state"], status["wanted"]) == ("done", list(PHASES))
    assert json.loads(pictured.results.read_text())["data_sha256"] == status["data_sha256"]
    assert {"command", "platform", "versions"} == set(pictured.read_json("environment.json"))
    assert yaml.safe_load(pictured.config.read_text())["experiment"] == "smoke"
    assert not list(pictured.path.rglob("*.tmp"))


def test_trained_run_can_be_looked_at_again(pictured: RunDirectory, tmp_path: Path) -> None:
    again = plp("test", pictured.path, "--output", tmp_path / "test.json")
    assert again.code == 0, again
    told, results = json.loads((tmp_path / "test.json").read_text()), json.loads(pictured.results.read_text())
    for trial in TRIALS:
        assert {**told["trials"][trial], "before": results[trial]["before"]} == results[trial]
    assert "val/bc_tall: " in plp("validate", pictured.path, "--phase", "alignment", "--which", "best").out
    assert "steps of flat, tall" in plp("predict", pictured.path, "--output", tmp_path / "p.npz").out


def test_checkpoint_can_be_tested_with_a_config_instead(pictured: RunDirectory, tmp_path: Path) -> None:
    options = [
        *tiny_smoke(tmp_path),
        "--checkpoint",
        pictured.checkpoint("adaptation"),
        "--output",
        tmp_path / "t.json",
    ]
    answer = plp("test", *options, "--episodes", "2")
    assert answer.code == 0, answer
    assert json.loads((tmp_path / "t.json").read_text())["trials"]["target"]["episodes"] == 2


def test_transfer_works_where_the_answer_is_known(tmp_path: Path) -> None:
    options = ["--data.root", data_root(), "--run_root", tmp_path, "--evaluation.latent_states", "0"]
    answer = plp("fit", *SMOKE, *options)
    assert answer.code == 0, answer
    results = json.loads(smoke_run(tmp_path).results.read_text())
    assert results["target"]["before"] <= 0.1
    assert results["target"]["success"] >= 0.9
    assert results["source"]["success"] >= 0.9
    assert results["alignment"]["closeness"] >= 0.5
