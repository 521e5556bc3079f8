"""What the page for owners of two robots tells is true: its lines run on files of each format, in miniature."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tiny
import tomllib
import yaml
from command import ROOT, plp

from datamodules.store.writer import write_trajectories
from plp_lightning.cli.config import parse

TEXT = (ROOT / "docs" / "own_robots.md").read_text()
SHELL, OTHER_IMPORTS = re.findall(r"```bash\n(.*?)```", TEXT, re.DOTALL)
(PAGE,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
(CODE,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
TARGET = yaml.safe_load(PAGE)["data"]["target_task"]
ROBOTS = {"lab_arm": "flat", "factory_arm": "tall"}
LITTLE = ["--config", str(ROOT / "tests" / "conf" / "tiny.yaml")]
HZ = {"lerobot": 10, "robomimic": 20, "minari": 20}
ALL = ["--data.trajectories", "null", "--data.target_trajectories", "null"]
FORMATS = {  # format: what exports it, the files' ending
    "lerobot": (["lerobot"], ""),
    "lerobot, older": (["lerobot", "--version", "2.1"], ""),
    "robomimic": (["robomimic"], ".hdf5"),
    "minari": (["minari"], "-v0"),
    "minari, arrow": (["minari", "--layout", "arrow"], "-v0"),
}


def lines(block: str, start: str) -> list[list[str]]:
    """Words of a block's lines that begin so."""
    return [shlex.split(line) for line in block.splitlines() if line.startswith(start)]


def named(task: str, form: str) -> str:
    """A task as owners of such files call it: sentences, but masks of robomimic are names."""
    told = TARGET if task == tiny.TARGET else f"reach {task.replace('_', ' ')}"
    return told.replace(" ", "_") if form == "robomimic" else told


def make_files(form: str, folder: Path) -> None:
    """Files of both robots, as the page calls them; the target robot was shown its target task too."""
    words, ending = FORMATS[form]
    made = [dataclasses.replace(one, task=named(one.task, words[0])) for one in tiny.demonstrations(4)]
    specs = [domain.world.spec(name) for name, domain in tiny.domains().items()]
    write_trajectories(folder / "ours.hdf5", specs, tuple(named(t, words[0]) for t in tiny.TASKS), made, {})
    for robot, domain in ROBOTS.items():
        kind, *options = words
        out = folder / f"{robot}{ending}"
        answer = plp("data", "export", kind, folder / "ours.hdf5", "--domain", domain, "--out", out, *options)
        assert answer.code == 0, answer


def bring(form: str, folder: Path) -> list[str]:
    """Run the page's imports of a format in a folder with nothing but the files; words of its ``plp fit``."""
    make_files(form, folder)
    kind = FORMATS[form][0][0]
    (folder / "arms.yaml").write_text(PAGE.replace(TARGET, named(tiny.TARGET, kind)))
    imports = lines(SHELL if kind == "lerobot" else OTHER_IMPORTS, f"plp data import {kind} ")
    assert len(imports) == len(ROBOTS)
    for words in [*imports, *lines(SHELL, "plp data inspect")]:
        answer = plp(*words[1:])
        assert answer.code == 0, answer
    (fit,) = lines(SHELL, "plp fit")
    return [*fit[1:], *LITTLE, *ALL]


@pytest.mark.parametrize("form", FORMATS)
def test_files_of_each_format_are_what_the_experiment_wants(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data = parse(bring(form, tmp_path)[1:]).data
    assert {*data.proxy_tasks} == {named(task, FORMATS[form][0][0]) for task in tiny.PROXIES}
    limits = {name: dataset.spec.action_limits for name, dataset in data.datasets.items()}
    given = {"lab_arm": 1.5, "factory_arm": 6.0} if "minari" not in form else dict.fromkeys(ROBOTS, 1.0)
    assert limits == {name: ((-most,) * 2, (most,) * 2) for name, most in given.items()}
    assert [dataset.spec.control_hz for dataset in data.datasets.values()] == [HZ[FORMATS[form][0][0]]] * 2


def test_the_lines_lead_from_files_to_a_policy_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    trained = plp(*bring("lerobot", tmp_path))
    assert trained.code == 0, trained
    (export,) = lines(SHELL, "plp export")
    assert f"run directory: {export[2]}\n" in trained.out
    assert "verdict: " in trained.out
    answer = plp(*export[1:])
    assert answer.code == 0, answer
    card = json.loads(Path("factory_arm.onnx.json").read_text())
    assert (card["domain"]["name"], card["task"], card["action_limits"]["high"]) == ("factory_arm", TARGET, [6, 6])
    names: dict[str, np.ndarray] = {}
    exec(CODE, names)
    assert names["action"].shape == tuple(card["output"]["shape"][1:])
    assert np.isfinite(names["action"]).all()


def test_the_page_is_as_short_as_it_promises() -> None:
    for block in (SHELL, SHELL.replace("lerobot", "") + OTHER_IMPORTS):
        assert len([line for line in block.splitlines() if not line.startswith("#")]) <= 12
    assert len(PAGE.splitlines()) <= 30
    assert {*yaml.safe_load(PAGE)} == {"domains", "data"}
    assert {*yaml.safe_load(PAGE)["data"]} == {"file", "source_domain", "target_domain", "target_task"}
    assert len([line for line in CODE.splitlines() if line]) <= 5


def test_what_is_to_be_installed_can_be() -> None:
    (install,) = lines(SHELL, "pip install")
    extras = re.findall(r"[a-z]+", install[-1])
    assert extras
    assert {*extras} <= {*tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]}
