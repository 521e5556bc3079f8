"""Runs know the recipe and the sweep that they are of, and no two recipes write into one directory."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from command import SMOKE, complaint, plp, tiny_smoke

from plp_lightning.cli.config import parse
from plp_lightning.cli.planning import plan
from plp_lightning.runs.settings import config_hash, differing_settings
from plp_lightning.sweeps.page import SweepPage


def test_a_recipe_stands_in_the_directory_and_in_the_results(tmp_path: Path) -> None:
    words = tiny_smoke(tmp_path)
    assert plp("fit", *words, "--recipe", "literal", "--sweep", "evidence_c").code == 0
    folder = tmp_path / "smoke" / "plp_literal" / "goal_3" / "seed_0"
    results = json.loads((folder / "results.json").read_text())
    assert (results["method"], results["recipe"], results["sweep"]) == ("plp_literal", "literal", "evidence_c")
    again = parse(["--config", str(folder / "config.yaml")])
    assert again.run_path == folder
    assert parse(words).run_path == tmp_path / "smoke" / "plp" / "goal_3" / "seed_0"


def test_names_of_recipe_and_sweep_decide_nothing_of_a_run() -> None:
    plain, named = (yaml.safe_load(parse([*SMOKE, *w]).config) for w in ([], ["--recipe=x", "--sweep=y"]))
    assert (named["recipe"], named["sweep"]) == ("x", "y")
    assert config_hash(plain) == config_hash(named)
    assert differing_settings(plain) == differing_settings(named)
    older = {key: value for key, value in plain.items() if key not in ("recipe", "sweep")}
    assert config_hash(older) == config_hash(plain)


def test_a_sweep_of_both_recipes_names_each_once_and_itself(tmp_path: Path) -> None:
    page = tmp_path / "mine.yaml"
    page.write_text("recipe: literal")
    overrides = {"plain": None, "literal": {"config": str(page)}}
    runs = plan([SweepPage(experiments=["smoke"], overrides=overrides, root=str(tmp_path))], [], name="evidence_c")
    assert [run.name for run in runs] == ["smoke/plp/goal_3/seed_0", "smoke/plp_literal/goal_3/seed_0"]
    assert all("--sweep=evidence_c" in run.words for run in runs)


@pytest.mark.parametrize("name", ["../a", "a/b", "a b", "x" * 64, "ä"])
def test_a_recipe_that_names_no_folder_is_one_line(name: str, tmp_path: Path) -> None:
    assert f"method is 'plp_{name}'; expected up to 64 letters" in complaint(
        "fit", *tiny_smoke(tmp_path), f"--recipe={name}"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_s_name_comes_from_its_page(tmp_path: Path) -> None:
    words = ["sweep", "--config", "sweeps/smoke", "--root", str(tmp_path), "--dry_run"]
    assert "--sweep comes from the name of the sweep's page" in complaint(*words, "--sweep=mine")
