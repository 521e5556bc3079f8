"""What the README tells a newcomer is true: commands, keys, places and the Python of the public interface."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from command import ROOT, plp, smoke_run, tiny_smoke

from plp_lightning.cli.config import parse
from plp_lightning.cli.verbs import find_verb

README = (ROOT / "README.md").read_text()
CODE = {language: re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) for language in ("bash", "python")}
READING_PATH = 900
"""Most lines that a newcomer should have to read before the house is clear."""


def commands() -> list[list[str]]:
    """Words of every ``plp`` of the README, files as they are found from anywhere."""
    lines = [line for block in CODE["bash"] for line in block.splitlines() if line.startswith("plp ")]
    split = [shlex.split(line, comments=True)[1:] for line in lines]
    return [[str(ROOT / word) if word.startswith("configs/") else word for word in words] for words in split]


def test_every_command_is_understood() -> None:
    assert len(commands()) >= 8
    for verb, *words in commands():
        find_verb(verb)
        if verb == "fit":
            parse(words)


def test_every_key_in_the_text_is_an_option() -> None:
    flags = re.findall(r"`--((?:alignment|policy|domains|trainer|evaluation|data)\.[^` ]+) ([^`]+)`", README)
    assert len(flags) >= 5
    page = ["--config", str(ROOT / "configs" / "r2r.yaml")]
    parse([*page, *(word for key, value in flags for word in (f"--{key}", value))])


@pytest.mark.parametrize("code", CODE["python"])
def test_python_runs_as_it_stands(code: str, tmp_path: Path) -> None:
    assert plp("fit", *tiny_smoke(tmp_path)).code == 0
    ours = {"runs/r2r/plp/x2y2h2/seed_0": str(smoke_run(tmp_path).path), "ur5e": "tall", "x2y2h2": "goal_3"}
    for theirs, here in ours.items():
        assert theirs in code
        code = code.replace(theirs, here)
    names = {"states": np.zeros((3, 7), np.float32)}
    exec(code, names)
    assert names["actions"].shape == (3, 2)


def test_a_newcomer_reads_few_lines() -> None:
    told = README[README.index("A newcomer reads") :].split("\n\n")[0]
    files = re.findall(r"`([a-z_/]+\.py)`", told)
    lines = sum(len((ROOT / file).read_text().splitlines()) for file in files)
    assert len(files) >= 6
    assert lines <= READING_PATH
    assert re.search(r"\((\d+) lines\)", told) is None, "a number that grows old; the test holds the bound"


def test_every_place_is_there() -> None:
    house = README[README.index("## The house") :]
    rows = re.findall(r"^\| (`[^|]+) \|", house, re.MULTILINE)
    places = [word for row in rows for word in re.findall(r"`(.+?)`", row)]
    assert len(places) >= 14
    for place in places:
        homes = (ROOT, ROOT / "plp_lightning")
        assert any((home / place).is_dir() for home in homes), f"README.md: there is no {place}"
