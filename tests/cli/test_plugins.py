"""Installed packages make their classes known by short names; a user's own are found in the working folder."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from command import complaint, plp, smoke_run, tiny_smoke

from plp_lightning.cli.config import parse
from plp_lightning.plugins import plugins

SCORE = "from plp_lightning.evaluation.mixing import NeighbourhoodScore\nclass {}(NeighbourhoodScore): ...\n"


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    path = [*sys.path]
    plugins.cache_clear()
    yield
    plugins.cache_clear()
    sys.path[:] = path


def install(folder: Path, module: str, content: str, group: str = "plp.terms") -> None:
    """Put a module and the record of its installation into a folder."""
    (folder / f"{module}.py").write_text(content)
    record = folder / f"{module}-1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (record / "entry_points.txt").write_text(f"[{group}]\nall = {module}\n")


@pytest.mark.parametrize("group", ["plp.simulators", "plp.terms", "plp.methods"])
def test_an_installed_package_is_known_by_short_names(
    group: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = f"installed_{group[4:]}"
    install(tmp_path, module, SCORE.format(module.title()), group)
    monkeypatch.syspath_prepend(tmp_path)
    experiment = parse([*tiny_smoke(tmp_path), "--score", f"[{module.title()}]"])
    assert experiment.score is not None
    assert type(experiment.score.scores[0]).__module__ == module


def test_a_broken_one_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "broken_plugin", "raise LookupError('lost')")
    monkeypatch.syspath_prepend(tmp_path)
    told = complaint("fit", *tiny_smoke(tmp_path))
    assert "entry point 'all' (broken_plugin) can't be imported: LookupError: lost; mend the package" in told


def test_a_package_of_ones_own_is_found_in_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "working_score.py").write_text(SCORE.format("WorkingScore"))
    monkeypatch.chdir(tmp_path)
    words = [*tiny_smoke(tmp_path), "--score", "[working_score.WorkingScore]"]
    assert "importing 'working_score.WorkingScore' is not allowed" in complaint("fit", *words)
    trusting = ["--allow_imports", "working_score"]
    answer = plp("fit", *words, *trusting)
    assert answer.code == 0, answer
    run = smoke_run(tmp_path).path
    for verb in ("test", "validate", "predict"):
        assert plp(verb, run, *trusting).code == 0
    assert plp("export", run, "--to", "safetensors", *trusting).code == 0
