"""Several alignment scores on one experiment: each under its own name, read from a list or, as before, alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tiny
import torch
import yaml
from command import SMOKE, complaint, plp, smoke_run, tiny_smoke

from datamodules.errors import ConfigError
from plp_lightning.cli.config import parse
from plp_lightning.evaluation.scores import AlignmentScore, ClosenessScore, JointScore
from plp_lightning.runs.metrics_file import read_rows

SIMULATORS = {name: domain.simulator for name, domain in tiny.domains().items()}


class Constant(AlignmentScore):
    """Scores whatever it is given alike, under a name of its choice."""

    def __init__(self, name: str = "constant") -> None:
        self.name = name

    def __call__(self, policy: object, data: object, simulators: object) -> dict[str, float]:
        return {self.name: 0.5}

    def of_target(self, policy: object, data: object, simulators: object) -> dict[str, float]:
        return {f"{self.name}_target": 0.25}


def test_every_score_keeps_its_name_and_the_first_that_can_says_what_corresponds(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    policy = tiny.policy(data)
    joint = JointScore([Constant(), ClosenessScore(30), Constant("other")])
    found = joint(policy, data, SIMULATORS)
    assert list(found) == ["constant", "closeness", "other"]
    assert found["closeness"] == ClosenessScore(30)(policy, data, SIMULATORS)["closeness"]
    assert joint.of_target(policy, data, SIMULATORS) == {"constant_target": 0.25, "other_target": 0.25}
    pairs, alone = (score.correspondences(data, SIMULATORS, 4) for score in (joint, ClosenessScore(30)))
    assert pairs is not None
    assert all(torch.equal(seen.state, alone[domain].state) for domain, seen in pairs.items())
    assert JointScore([Constant()]).correspondences(data, SIMULATORS, 4) is None


def test_names_that_two_scores_share_are_refused(trajectory_file: Path) -> None:
    assert "score: ClosenessScore and ClosenessScore both give 'closeness'" in complaint(
        "fit", *SMOKE, "--score+=ClosenessScore", "--print_config"
    )
    data = tiny.data_module(trajectory_file)
    joint = JointScore([Constant(), Constant()])  # nobody said before which names they have
    with pytest.raises(ConfigError, match="Constant and Constant both give 'constant'; expected names of their own"):
        joint(tiny.policy(data), data, SIMULATORS)


@pytest.mark.parametrize(
    ("written", "names"),
    [
        ("{class_path: ClosenessScore, init_args: {samples: 7}}", [("ClosenessScore", 7)]),
        ("[{class_path: ClosenessScore, init_args: {samples: 7}}]", [("ClosenessScore", 7)]),
        (
            "[{class_path: ClosenessScore}, {class_path: PairAccuracy, init_args: {samples: 9}}]",
            [("ClosenessScore", 2000), ("PairAccuracy", 9)],
        ),
        ("null", []),
        ("[]", []),
    ],
)
def test_a_configuration_holds_a_list_of_scores_or_as_before_one(
    written: str, names: list[tuple[str, int]], tmp_path: Path
) -> None:
    (tmp_path / "score.yaml").write_text(f"score: {written}\n")
    experiment = parse([*SMOKE, "--config", str(tmp_path / "score.yaml")])
    resolved = yaml.safe_load(experiment.config)["score"]
    assert [(found["class_path"].split(".")[-1], found["init_args"]["samples"]) for found in resolved] == names
    assert (experiment.score is None) == (not names)


def test_a_second_score_of_ones_own_is_logged_kept_and_validated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [
        "from plp_lightning.evaluation.scores import AlignmentScore",
        "class Half(AlignmentScore):",
        "    def __call__(self, policy, data, simulators):",
        "        return {'half': 0.5}",
    ]
    (tmp_path / "package_of_scores.py").write_text("\n".join(lines) + "\n")
    (tmp_path / "half.yaml").write_text("score+: [{class_path: package_of_scores.Half}]\n")
    monkeypatch.syspath_prepend(tmp_path)
    trusted = ["--allow_imports", "package_of_scores"]
    plain = [word for word in tiny_smoke(tmp_path) if word not in ("--score.samples", "50")]
    answer = plp("fit", *plain, "--config", tmp_path / "half.yaml", *trusted)
    assert answer.code == 0, answer
    run = smoke_run(tmp_path)
    found = json.loads(run.results.read_text())["alignment"]
    assert list(found) == ["closeness", "half"]
    assert found["half"] == 0.5
    logged = {name for _, name, _ in read_rows(run.phase("alignment") / "metrics.csv")}
    assert {"alignment/closeness", "alignment/half"} <= logged
    again = ["--config", run.config, *trusted, "--checkpoint", run.checkpoint("adaptation")]
    assert "half: 0.5000" in plp("validate", *again).out
