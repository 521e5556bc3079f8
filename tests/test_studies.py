"""Studies are overrides in pages of sweeps, which docs/studies.md lists; a small one is run."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml
from command import ROOT, TINY, complaint, plp
from test_configs import invent_demonstrations

from plp_lightning.cli.config import parse
from plp_lightning.cli.planning import choose, find_word, plan, read_page
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.runs.settings import differing_settings
from plp_lightning.sweeps.page import SweepPage, variants


def absolute(words: list[str]) -> list[str]:
    """Configuration files as they are found from anywhere."""
    return [str(ROOT / word) if word.startswith("configs/") else word for word in words]


def numbers(words: list[str]) -> tuple[str, str, Mapping[str, int]]:
    """Experiment, method, and how many proxy demonstrations each domain brings."""
    experiment = parse(words)
    batch_spec = experiment.data.needed()
    proxy_tasks = experiment.data.proxy_tasks
    return (
        experiment.name,
        experiment.method.name,
        {d: sum(batch_spec[d][task] for task in proxy_tasks) for d in batch_spec},
    )


def test_sources_share_a_fixed_number_or_bring_as_many_each() -> None:
    runs = choose(plan(read_page(ROOT / "configs" / "sweeps" / "figure9.yaml"), []), "p2p_*/seed_0")
    rows = [numbers(run.words[1:]) for run in runs]
    assert len(rows) == 7
    for name, method, found in rows:
        count = int(name.rsplit("_", 1)[1])
        sources = [n for domain, n in found.items() if domain != "point"]
        assert found["point"] == 1200
        assert len(sources) == count
        assert len({*sources}) == 1
        assert sum(sources) == (1200 if method == "plp_t_fixed" else 1200 * count)


def test_the_table_of_studies_has_every_page_with_its_runs() -> None:
    told = (ROOT / "docs" / "studies.md").read_text()
    rows = {name: int(count) for name, count in re.findall(r"^\| `(\w+)\.yaml` \|.*\| (\d+) \|$", told, re.MULTILINE)}
    pages = {page.stem: read_page(page) for page in (ROOT / "configs" / "sweeps").glob("*.yaml")}
    found = {name: sum(map(runs, parts)) for name, parts in pages.items() if name != "smoke"}
    assert found == rows


def runs(part: SweepPage) -> int:
    """Runs of a part of a sweep's page."""
    every = variants(part, find_word, [])
    return sum(max(1, len(variant.targets)) * len(variant.seeds) for variant in every)


@pytest.mark.parametrize("page", sorted((ROOT / "configs" / "studies").glob("*_sources_*.yaml")), ids=lambda p: p.stem)
def test_pages_of_several_sources_add_agents_to_their_experiment(page: Path) -> None:
    base = ROOT / "configs" / f"{page.stem.split('_sources')[0]}.yaml"
    alone = parse(["--config", str(base)])
    several = parse(["--config", str(base), "--config", str(page)])
    assert several.name == page.stem
    assert (several.data.source_domain, several.data.target_domain) == (
        alone.data.source_domain,
        alone.data.target_domain,
    )
    assert len(several.domains) == int(page.stem[-1]) + 1
    said = {name: domain.simulator.spec(name).env for name, domain in several.domains.items()}
    assert len({*said.values()}) == len(said)
    assert said.items() >= {name: domain.simulator.spec(name).env for name, domain in alone.domains.items()}.items()
    assert {domain.simulator.tasks.names for domain in several.domains.values()} == {several.data.tasks}


def test_fewer_goals_are_among_more_and_bring_all_their_starts() -> None:
    known = PointMaze("medium").tasks
    chosen = {n: known.proxies("goal_1_6", n) for n in range(1, 26)}
    for n, tasks in chosen.items():
        goals = {known.target_of(task) for task in tasks}
        assert len(goals) == n
        assert "goal_1_6" not in goals
        assert {*tasks} == {task for goal in goals for task in known.of(goal)}
        assert {*tasks} >= {*chosen.get(n - 1, ())}
    assert chosen[25] == known.proxies("goal_1_6")
    assert chosen[5] == WalkerMaze("medium").tasks.proxies("goal_1_6", 5)
    assert chosen[5] == tuple(task for task in known.proxies("goal_1_6") if task in chosen[5])


def test_every_task_is_part_of_its_own_target() -> None:
    for known in (PointMaze("medium").tasks, PointMaze("umaze").tasks, LinearPoint(1).tasks):
        assert all(task in known.of(known.target_of(task)) for task in known.names)


def test_too_many_goals_are_named() -> None:
    words = ["--config", str(ROOT / "configs" / "p2p_umaze.yaml"), "--data.proxy_goals"]
    assert "--data.proxy_goals is 7; expected 1 to 6" in complaint("fit", *words, 7)
    assert "data.proxy_goals is 0; expected a whole number, at least 1; change it" in complaint("fit", *words, 0)


def test_three_sources_run_in_miniature(tmp_path: Path) -> None:
    words = absolute(["--config", "configs/p2p_medium.yaml", "--config", "configs/studies/p2p_medium_sources_3.yaml"])
    words += ["--config", str(ROOT / "configs" / "methods" / "plp_t.yaml"), *TINY]
    words += ["--data.root", str(tmp_path), "--run_root", str(tmp_path), "--data.proxy_goals", "2"]
    words += ["--data.source_trajectories", "8", "--data.trajectories", "16"]
    for name in parse(words).domains:
        words += [f"--domains.{name}.simulator.horizon", "5"]
    experiment = parse(words)
    assert {*experiment.data.needed()["turned"].values()} == {1}
    invent_demonstrations(experiment)
    answer = plp("fit", *words)
    assert answer.code == 0, answer
    results = json.loads((experiment.run_path / "results.json").read_text())
    assert (results["experiment"], results["method"]) == ("p2p_medium_sources_3", "plp_t")
    assert results["proxy"]["episodes"] == 4


@pytest.mark.parametrize("page", ["v2v_reach", "v2v_open"])
def test_the_paper_s_settings_of_v2v_are_an_overlay(page: str) -> None:
    def settings(*further: str) -> tuple[object, ...]:
        config = yaml.safe_load(parse(["--config", str(ROOT / "configs" / f"{page}.yaml"), *further]).config)
        phases = [config[phase]["init_args"] for phase in ("alignment", "adaptation")]
        schedules = [phase["lr_scheduler"] and phase["lr_scheduler"]["class_path"].split(".")[-1] for phase in phases]
        downsampling = phases[0]["terms"]["reconstruction"]["init_args"]["downsampling"]
        return phases[0]["epochs"], downsampling, schedules, config["trainer"]["precision"]

    assert settings() == (20, 1, ["CosineDecay", "CosineDecay"], "bf16-mixed")
    paper = str(ROOT / "configs" / "studies" / "v2v_paper.yaml")
    assert settings("--config", paper) == (80, 0, [None, None], "32-true")


def test_r2r_at_the_paper_s_settings_is_r2r_but_for_them() -> None:
    """A page builds on no other, so each states all."""
    ours, paper = (
        differing_settings(yaml.safe_load(parse(["--config", str(ROOT / "configs" / f"{name}.yaml")]).config))
        for name in ("r2r", "r2r_paper")
    )
    assert {key for key in ours | paper if ours.get(key) != paper.get(key)} == {
        *("alignment.epochs", "alignment.optimizer.lr", "adaptation.epochs", "collection.random_start_steps")
    }
