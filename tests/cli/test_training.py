from __future__ import annotations

import json

import pytest
from command import ROOT, complaint, plp

from datamodules.errors import CheckpointError
from plp_lightning.cli import training
from plp_lightning.cli.config import parse
from plp_lightning.envs.experts.gait import Gait

UMAZE = ["--config", str(ROOT / "configs" / "p2a_umaze.yaml")]


@pytest.mark.filterwarnings("ignore")  # stable-baselines3 warns of what it does itself
def test_an_expert_is_trained_and_used(tmp_path):
    pytest.importorskip("stable_baselines3")
    weights = tmp_path / "gaits" / "ant.safetensors"
    answer = plp("collect", *UMAZE, "--train_expert", "ant", "--weights", weights, "--steps", 1000, "--seed", 3)
    assert answer.code == 0, answer
    lines = answer.out.splitlines()
    assert lines[0].startswith("training ant: 1000/1000 steps")
    assert lines[-1].endswith(f"demonstrate with it by --domains.ant.expert.weights {weights}")
    record = json.loads(weights.with_suffix(".json").read_text())
    assert (record["legs"], record["seed"], record["steps"]) == (4, 3, 8192)
    assert Gait.load(weights).legs == 4

    before = weights.read_bytes()
    again = complaint("collect", *UMAZE, "--train-expert", "ant", "--weights", weights)
    assert "ant.safetensors: the file exists; expected a new one" in again
    assert weights.read_bytes() == before


def test_an_experiment_names_its_gait(tmp_path):
    experiment = parse([*UMAZE, "--domains.ant.expert.weights", str(tmp_path / "ant.safetensors")])
    maze, expert = experiment.domains["ant"].simulator, experiment.domains["ant"].expert
    with pytest.raises(CheckpointError, match=f"no gait at {tmp_path}/ant.safetensors; name another file or train one"):
        expert.begin(maze, ["s0_g_3_1"], [0])


def test_mistakes_are_told_in_one_line(tmp_path, monkeypatch):
    weights = tmp_path / "ant.safetensors"

    def told(domain: str, *options: object) -> str:
        return complaint("collect", *UMAZE, "--train_expert", domain, *options)

    assert "lacks --weights FILE" in told("ant")
    assert "lacks --train_expert DOMAIN" in complaint("collect", *UMAZE, "--weights", weights)
    assert "'spider'; the experiment's domains are point, ant" in told("spider", "--weights", weights)
    assert "only experts of WalkerMaze are trained, not those of PointMaze" in told("point", "--weights", weights)
    assert "expected a name that ends in .safetensors" in told("ant", "--weights", tmp_path / "ant.pt")
    assert "expected a whole number of at least 1" in told("ant", "--weights", weights, "--steps", "0")
    weights.with_suffix(".json").write_text("{}")
    assert "ant.json: the file exists" in told("ant", "--weights", weights)
    weights.with_suffix(".json").unlink()
    monkeypatch.setattr(training, "find_spec", lambda name: None)
    assert "needs stable-baselines3, which is not installed; install the extra 'experts'" in told(
        "ant", "--weights", weights
    )
    assert list(tmp_path.iterdir()) == []


def test_help_shows_the_training_and_the_configuration():
    out = plp("collect", "--help").out
    assert "--train_expert" in out
    assert "--data.target_task" in out
