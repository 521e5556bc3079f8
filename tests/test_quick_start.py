"""The first page and the notebook lead to a film of two robots, run as they stand but for their length."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command import ROOT, TINY, plp
from snippets import cells, commands

EXAMPLES, NOTEBOOK = ROOT / "docs" / "examples", ROOT / "docs" / "notebooks" / "two_data_sets.ipynb"
TEXT = (ROOT / "docs" / "index.md").read_text()
ALL = ["--data.trajectories", "null", "--data.target_trajectories", "null"]
SHORT = [*TINY[:2], *ALL, "--alignment.epochs", "1", "--adaptation.epochs", "1", "--data.epoch_steps", "1"]
LITTLE = {"fit": [*SHORT, "--evaluation.latent_states", "20"], "rollout": ["--among", "2", "--episodes", "1"]}
"""What is added to a verb's words, so that it takes seconds."""


@pytest.fixture(autouse=True)
def _beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder without anything; what is run may change path, folder and environment, which are put back."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv("PYTHONPATH", os.environ.get("PYTHONPATH", ""))
    monkeypatch.chdir(tmp_path)


def run(words: list[str]) -> None:
    answer = plp(*words, *LITTLE.get(words[0], []))
    assert answer.code == 0, answer


def test_the_first_page_leads_from_two_environments_to_a_film(tmp_path: Path) -> None:
    for file in EXAMPLES.glob("two_robots.*"):
        (tmp_path / file.name).write_text(file.read_text())
    sys.path.insert(0, str(tmp_path))
    robots: Any = importlib.import_module("two_robots")
    robots.record("gantry", [*robots.PLACES], 2)
    robots.record("arm", [task for task in robots.PLACES if task != robots.TARGET], 2)
    for words in [words for page, words in commands() if page == "docs/index.md" and words[0] == "plp"]:
        if words[1] != "doctor":
            run([*words[1:]])
    (told,) = re.findall(r"in `(runs/\S+/rollouts)`", TEXT)
    assert {path.suffix for path in Path(told).iterdir()} == {".mp4", ".gif", ".json"}


def test_the_notebook_leads_from_two_data_sets_to_a_film(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(NOTEBOOK.parent)
    shown: list[bytes] = []
    display = SimpleNamespace(Image=lambda path: path.read_bytes(), display=lambda *images: shown.extend(images))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    names: dict[str, Any] = {}
    for code in cells(NOTEBOOK):
        do(re.sub(r", 12\)$", ", 2)", code, flags=re.MULTILINE), names)
    assert [image[:4] for image in shown] == [b"\x89PNG", b"GIF8"]
    assert names["policy"].tasks


def do(code: str, names: Mapping[str, Any]) -> None:
    """Run a cell; a line for a shell has names of Python in braces."""
    if code.startswith("!plp "):
        run(shlex.split(re.sub(r"\{(\w+)\}", lambda found: str(names[found[1]]), code))[1:])
    else:
        exec(code, names)  # type: ignore[arg-type]


def test_the_notebook_is_kept_without_outputs() -> None:
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None
