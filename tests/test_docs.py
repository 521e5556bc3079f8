"""Snippets of the documentation do what they say: commands are understood, Python runs, pages of settings are read."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cameras
import numpy as np
import pytest
import tomllib
import yaml
from command import ROOT, plp
from snippets import Snippet, commands, snippets

from datamodules.errors import TrajectoryFileError
from datamodules.formats.source import Format, Source, SourceDescription, SourceEpisode, SourceKey
from datamodules.plain_yaml import parse_yaml
from plp_lightning.cli import experiments
from plp_lightning.cli.config import parse
from plp_lightning.cli.main import find_verb
from plp_lightning.cli.options import OptionParser
from plp_lightning.cli.planning import SweepPage

ELSEWHERE = {
    "cd, cp, export, mkdir, source": "the shell's own",
    "tensorboard, jq": "programs of others; the board's pages are tests/runs/test_board_page.py",
    "torchrun": "tests/test_several_devices.py",
    "python3, python": "environments of their own; test_quick_start.py runs the example",
}
"""First words of commands that are neither ours nor pip's, and why nothing is asked of them here."""

RUN_ELSEWHERE = {"README.md": "test_readme.py", "docs/own_robots.md": "test_own_robots.py"}
OWN_ARM = 'import gymnasium, two_robots\ngymnasium.register("OwnArm-v0", lambda **made: two_robots.Arm())\n'
"""Another's package, as docs/gymnasium.md has one."""
OTHER_PAGES = {"docs/report.md": {"name", "recipe", "source", "runs", "values", "tables"}, "docs/sweeps.md": None}
NOT_INSTALLED = ("WandbLogger",)
ROBOTS = [dataclasses.replace(spec, name=name) for spec, name in ((cameras.BLIND, "sawyer"), (cameras.TWO, "left"))]
OURS = sorted({words for _, words in commands() if words[0] == "plp"})


class Understood(BaseException):
    """A command's words were read to the end."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what a reader has beside the checkout, the example's packages on Python's path."""
    for name in ("configs", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "own_robots.py").write_text(OWN_ARM)
    for name in ("two_robots.yaml", "two_robots.py"):
        (tmp_path / name).symlink_to(ROOT / "docs" / "examples" / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT / "docs" / "examples")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@contextmanager
def reading_alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Stop a verb as soon as its words are read."""

    def stopping(read: Any) -> Any:
        def parse_args(self: OptionParser, *words: Any, **named: Any) -> Any:
            told = read(self, *words, **named)
            if self.prog in ("plp data import", "plp data export"):  # these ask a second parser
                return told
            raise Understood

        return parse_args

    with monkeypatch.context() as patch:
        patch.setattr(OptionParser, "parse_args", stopping(argparse.ArgumentParser.parse_args))
        patch.setattr(OptionParser, "parse_known_args", argparse.ArgumentParser.parse_known_args)
        yield


def settings(words: Sequence[str]) -> None:
    """Read the settings of a run; demonstrations need not be there."""
    try:
        parse(words)
    except TrajectoryFileError as error:
        if "no such file" not in str(error):
            raise


RUNS = [words for words in OURS if words[1] in ("fit", "collect") and len(words) > 4]  # test_configs.py reads each page


@pytest.mark.parametrize("words", RUNS, ids=" ".join)
def test_every_run_is_one_that_can_be(words: tuple[str, ...], place: Path) -> None:
    options = experiments._fit_options() if words[1] == "fit" else experiments._collect_options()
    known, rest = options.parse_known_args(words[2:])
    if getattr(known, "resume", None):
        assert rest in ([], ["--trainer.devices", "1"])
        return
    for page in (page for page in words if page.endswith(".yaml") and not Path(page).exists()):
        (block,) = [b.code for b in snippets("yaml") if b.page in _pages_of(words) and "domains:" in b.code]
        Path(page).write_text(block)
    settings(rest)


def _pages_of(words: tuple[str, ...]) -> list[str]:
    return [page for page, others in commands() if others == words]


@pytest.mark.parametrize("words", [words for words in OURS if words[1] not in ("fit", "collect")], ids=" ".join)
def test_every_command_is_understood(words: tuple[str, ...], place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled = [{"FORMAT": "minari", "SOURCE…": "theirs"}.get(word, word) for word in words[1:]]
    verb = find_verb(filled[0])
    for file in (word for word in filled if word.startswith(("configs/", "docs/"))):
        assert Path(file).exists()
    with reading_alone(monkeypatch), pytest.raises(Understood):
        _read(verb, filled)


def _read(verb: Any, words: Sequence[str]) -> None:
    if words[0] == "sweep":  # what it doesn't know goes to plp fit
        from plp_lightning.cli.sweep import _options

        known, rest = _options().parse_known_args(words[1:])
        assert known.config
        assert all(word.startswith("--") for word in rest[::2])
        raise Understood
    verb(words[1:])


def test_every_other_command_is_there() -> None:
    extras = {*tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]}
    known = {word for names in ELSEWHERE for word in names.split(", ")}
    for page, words in commands():
        if words[0] == "pip":
            assert {*re.findall(r"\w+", "".join(re.findall(r"\[(.*)\]", words[-1])))} <= extras
        elif words[0].startswith("script/"):
            assert (ROOT / words[0]).exists(), page
        else:
            assert words[0] in {"plp", *known}, f"{page}: {' '.join(words)}: nothing here tries it; see ELSEWHERE"
        for file in (word for word in words if word.startswith(("docs/", "configs/"))):
            assert [*ROOT.glob(file)], f"{page}: there is no {file}"


@pytest.mark.parametrize("snippet", snippets("yaml"), ids=str)
def test_every_page_of_settings_is_read(snippet: Snippet, place: Path) -> None:
    found = parse_yaml(snippet.code)
    if found is None:
        assert snippet.code.startswith("#")
        return
    if snippet.page in OTHER_PAGES:
        assert {*found} <= (OTHER_PAGES[snippet.page] or {*SweepPage.__dataclass_fields__})
        return
    if any(name in snippet.code for name in NOT_INSTALLED):
        assert {*found} == {"trainer"}
        return
    (place / "page.yaml").write_text(snippet.code)
    below = [] if "domains" in found else ["--config", "configs/v2v_reach.yaml"]
    named = [name for name in ("coral", "patches", "own_robots") if f"{name}" in snippet.code]
    settings([*below, "--config", "page.yaml", *(f"--allow_imports={name}" for name in named)])


def test_every_other_block_is_read() -> None:
    for one in snippets("json"):
        json.loads(one.code)
    for one in snippets("toml"):
        tomllib.loads(one.code)


def given(page: str) -> dict[str, Any]:
    """What the Python of a page says nothing about."""
    if page == "docs/format.md":
        made = [cameras.demonstration(spec, "lift", seed, 16) for spec in ROBOTS for seed in range(8)]
        halves = {"trajectories": made[::2], "more_trajectories": made[1::2], "recording": made[:3]}
        return {"domains": ROBOTS, "tasks": cameras.TASKS, **halves}
    names = {"Iterator": Iterator, "Sequence": Sequence, "contextmanager": contextmanager, "Path": Path, "np": np}
    types = (Format, Source, SourceDescription, SourceEpisode, SourceKey)
    return {**names, **{kind.__name__: kind for kind in types}} if page == "docs/importing.md" else {}


@pytest.mark.parametrize("snippet", [one for one in snippets("python") if one.page not in RUN_ELSEWHERE], ids=str)
def test_python_runs_as_it_stands(snippet: Snippet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(snippet.code, given(snippet.page))


def test_a_recording_of_the_page_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = "docs/formats/gymnasium.md"
    (code,) = [one.code for one in snippets("python") if one.page == page]
    exec(code, {})
    (words,) = [words for where, words in commands() if where == page]
    assert plp(*words[1:]).code == 0


EXPERIMENTS = sorted({*(ROOT / "docs" / "experiments").glob("*.md")} - {ROOT / "docs" / "experiments" / "README.md"})


@pytest.mark.parametrize("page", EXPERIMENTS, ids=lambda page: page.stem)
def test_the_table_of_an_experiment_is_true(page: Path) -> None:
    experiment, text = parse(["--config", str(ROOT / "configs" / f"{page.stem}.yaml")]), page.read_text()
    for name, domain in experiment.domains.items():
        spec = domain.simulator.spec(name)
        assert re.search(rf"\| `{name}` \| \w+ \| {spec.state_size} \| .* \| {spec.action_size} \|", text)
    assert f"Target task: `{experiment.data.target_task}`" in text
    assert f"proxy tasks: {len(experiment.data.proxy_tasks)}." in text


def test_every_experiment_method_and_format_has_its_page() -> None:
    pages = {path.stem for path in (ROOT / "docs" / "experiments").glob("*.md")}
    assert {path.stem for path in (ROOT / "configs").glob("*.yaml")} - {"base"} <= pages
    told = (ROOT / "docs" / "methods" / "README.md").read_text()
    assert not [path.stem for path in (ROOT / "configs" / "methods").glob("*.yaml") if f"`{path.stem}`" not in told]
    from datamodules.formats.registry import format_names

    assert {*format_names()} <= {path.stem for path in (ROOT / "docs" / "formats").glob("*.md")}


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert cited["version"] == project["version"]
    assert cited["license"] == project["license"]
