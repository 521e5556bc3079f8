"""What runs of a sweep have in common, as the parser of ``plp fit`` understands their words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command import ROOT, plp

from datamodules.errors import ConfigError
from datamodules.plain_yaml import dump_yaml, parse_yaml
from plp_lightning.cli import planning
from plp_lightning.cli.config import parse
from plp_lightning.cli.planning import plan, read_page
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.sweeps.manifest import Job
from plp_lightning.sweeps.page import variants
from plp_lightning.sweeps.sharing import PlannedRun, jobs_of

SWEEPS = sorted((ROOT / "configs" / "sweeps").glob("*.yaml"))
SAME_PROXIES = {"data.proxy_tasks": ["goal_0", "goal_1"]}
TARGETS = {"experiments": ["smoke"], "targets": ["goal_3", "goal_6"]}


def planned(folder: Path, **page: Any) -> list[PlannedRun]:
    (folder / "page.yaml").write_text(dump_yaml(page))
    return plan(read_page(folder / "page.yaml", str(folder / "runs")), [])


def shared(folder: Path, **page: Any) -> list[tuple[str, str]]:
    jobs = jobs_of(planned(folder, **page), folder)
    return [(job.name, phase) for job in jobs for phase in job.after.values() if phase is not None]


@pytest.mark.parametrize("page", SWEEPS, ids=lambda page: page.stem)
def test_every_page_names_what_is_there(page: Path) -> None:
    found = [variant for part in read_page(page) for variant in variants(part, planning.find_word, [])]
    assert found
    first = found[0]
    target = [f"--data.target_task={first.targets[0]}"] if first.targets else []
    assert parse([*first.words, *target, f"--seed={first.seeds[-1]}"])


@pytest.mark.matrix
@pytest.mark.parametrize("page", SWEEPS, ids=lambda page: page.stem)
def test_every_run_of_every_page_is_understood(page: Path) -> None:
    assert plan(read_page(page), [])


def test_words_mean_what_was_planned(tmp_path: Path) -> None:
    runs = planned(tmp_path, **TARGETS, seeds=[0, 7], overrides={"none": None, "weak": {"alignment.epochs": 3}})
    assert len(runs) == 8
    for run in runs[1::3]:
        experiment = parse(run.words[1:])
        assert experiment.run_path == run.directory
        begun = tmp_path / run.name
        begun.mkdir(parents=True)
        (begun / "config.yaml").write_text(experiment.config)
        planning._check_same(run.name, begun, parse_yaml(experiment.config))
        older = {key: value for key, value in parse_yaml(experiment.config).items() if key != "handover"}
        (begun / "config.yaml").write_text(dump_yaml(older))
        planning._check_same(run.name, begun, parse_yaml(experiment.config))
        changed = parse_yaml(experiment.config) | {"handover": {"average_over": 0.1, "epoch": "last"}}
        with pytest.raises(ConfigError, match=r"handover\.average_over has changed since the run began"):
            planning._check_same(run.name, begun, changed)
    assert [run.name for run in runs[-2:]] == ["smoke/plp_weak/goal_6/seed_0", "smoke/plp_weak/goal_6/seed_7"]


def test_targets_of_the_same_proxies_share_their_alignment(tmp_path: Path) -> None:
    found = shared(tmp_path, **TARGETS, overrides={"few": SAME_PROXIES}, seeds=[0, 1])
    assert found == [(f"smoke/plp_few/goal_6/seed_{seed}", "alignment") for seed in (0, 1)]


def test_targets_of_other_proxies_share_nothing(tmp_path: Path) -> None:
    assert shared(tmp_path, **TARGETS) == []


def test_phases_that_see_the_target_task_are_not_shared(tmp_path: Path) -> None:
    found = shared(tmp_path, **TARGETS, methods=["cdil"], overrides={"few": SAME_PROXIES})
    assert found == [("smoke/cdil_few/goal_6/seed_0", "positions")]  # CDIL's alignment translates the target's states
    found = shared(tmp_path, **TARGETS, methods=["gama", "bc", "contextual"], overrides={"few": SAME_PROXIES})
    assert found == [("smoke/gama_few/goal_6/seed_0", "alignment"), ("smoke/bc_few/goal_6/seed_0", "alignment")]


@pytest.mark.parametrize(
    ("settings", "same"),
    [
        ({"adaptation.epochs": 3}, True),
        ({"data.mix_ratio": 1.0}, True),
        ({"data.target_trajectories": 7}, True),
        ({"collection.processes": 1}, True),
        ({"handover.epoch.adaptation": "best"}, True),
        ({"handover.average_over": {"adaptation": 0.1}}, True),
        ({"handover.epoch": "best"}, False),
        ({"handover.average_over.alignment": 0.1}, False),
        ({"alignment.epochs": 3}, False),
        ({"policy.hidden": 16}, False),
        ({"data.trajectories": 7}, False),
        ({"data.batch_size": 7}, False),
        ({"domains.flat.simulator.map_seed": 7}, False),
        ({"trainer.precision": "bf16-mixed"}, False),
        ({"evaluation.final_episodes": 7}, False),
    ],
)
def test_settings_that_decide_an_alignment(settings: dict[str, Any], same: bool, tmp_path: Path) -> None:
    found = shared(tmp_path, experiments=["smoke"], overrides={"none": {}, "other": settings})
    assert bool(found) == same


def test_a_manifest_and_lines_for_a_shell(tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_text(dump_yaml({**TARGETS, "overrides": {"few": SAME_PROXIES}}))
    answer = plp("sweep", "--config", tmp_path / "page.yaml", "--root", tmp_path / "my runs", "--print")
    lines = answer.out.splitlines()
    assert len(lines) == 4
    assert lines[-1].startswith("plp fit --config smoke --config methods/plp '--data.proxy_tasks=")
    assert lines[-1].endswith(f"--phase adaptation --from '{tmp_path}/my runs/smoke/plp_few/goal_3/seed_0'")
    told = plp("sweep", "--config", tmp_path / "page.yaml", "--root", tmp_path / "my runs", "--dry_run").out
    assert "2 runs: 0 done, 0 begun, 2 to begin" in told
    assert "smoke/plp_few/goal_6/seed_0: alignment of smoke/plp_few/goal_3/seed_0" in told
    assert not (tmp_path / "my runs").exists()


def test_phases_are_taken_from_a_run_that_only_leaves_away(tmp_path: Path) -> None:
    giver = planned(tmp_path, **TARGETS, overrides={"few": SAME_PROXIES})[0]
    run = RunDirectory.create(giver.directory, parse(giver.words[1:]).config, {})
    page, root = tmp_path / "page.yaml", tmp_path / "runs"
    words = ["sweep", "--config", page, "--root", root, "--only", "*/goal_6/*", "--print"]
    assert "--from" not in plp(*words).out
    done = {"phases": {"alignment": {"state": "done", "checkpoint_sha256": "", "sha256": ""}}, "data_sha256": ""}
    run.write_json("status.json", run.status() | done)
    assert plp(*words).out.rstrip().endswith(f"--phase adaptation --from {giver.directory}")


def test_a_job_that_has_begun_goes_on(tmp_path: Path) -> None:
    job = Job("a", ["fit", "--config", "b", "--allow_imports=mine"], "a.log", str(tmp_path / "a"))
    assert job.next_words() == job.words
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "config.yaml").write_text("")
    assert job.next_words() == ["fit", "--resume", str(tmp_path / "a"), "--allow_imports=mine"]
