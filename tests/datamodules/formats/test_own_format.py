"""A format of one's own is a class behind an entry point; its constructor's arguments become options."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import complaint, plp

from datamodules.formats import registry
from datamodules.formats.source import Format, Source, SourceDescription, SourceEpisode, SourceKey
from datamodules.store.writer import TrajectoryFile


class Table(Format):
    """Tables of numbers.

    Args:
        scale: What states are multiplied by.
        names: Tasks of the demonstrations.
    """

    title = "a table"

    def __init__(self, scale: float = 1.0, names: tuple[str, ...] = ("go",)) -> None:
        self.scale, self.names = scale, names

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        yield Rows(path, self)


class Rows(Source):
    def __init__(self, path: Path, form: Table) -> None:
        self.path, self.form, self.rows = path, form, np.loadtxt(path, ndmin=2)
        count = len(form.names)
        self.description = SourceDescription(path, [path], [SourceKey("q", (2,))], 1, episodes=count, fps=5)

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        for number, name in enumerate(self.form.names):
            values = {"q": self.rows[:, :2] * self.form.scale}
            yield SourceEpisode(f"table {number}", self.path, values, self.rows[:, 2:], name)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [EntryPoint("table", f"{__name__}:Table", registry.GROUP), EntryPoint("odd", "json:dumps", registry.GROUP)]

    def entry_points(group: str, **wanted: Any) -> list[EntryPoint]:
        return [point for point in points if all(getattr(point, key) == value for key, value in wanted.items())]

    monkeypatch.setattr(registry, "entry_points", entry_points)


@pytest.mark.usefixtures("installed")
def test_a_format_of_ones_own_is_imported_like_the_others(tmp_path: Path) -> None:
    (tmp_path / "x.txt").write_text("1 2 0.5\n3 4 -1\n")
    out = tmp_path / "x.hdf5"
    words = ["data", "import", "table", tmp_path / "x.txt", "--domain", "arm", "--out", out]
    answer = plp(*words, "--scale", 2, "--names", "go", "stay")
    assert answer.code == 0, answer
    with TrajectoryFile.open(out) as file:
        assert file.tasks == ("go", "stay")
        np.testing.assert_array_equal(file.read("arm", [0]).state, [[2, 4], [6, 8]])
    assert "argument --scale: invalid float value: 'x'" in complaint(*words, "--scale", "x")
    (tmp_path / "x.txt").write_text("1 2 x\n")
    assert "x.txt: found something that cannot be understood (ValueError" in complaint(*words)


@pytest.mark.usefixtures("installed")
def test_help_tells_a_formats_options(tmp_path: Path) -> None:
    told = " ".join(plp("data", "import", "table", "--help").out.split())
    assert "--scale SCALE What states are multiplied by. (default: 1.0)" in told
    assert "--action_low ACTION_LOW" in told
    assert "robomimic, lerobot, minari, d4rl, gymnasium, table" in plp("data", "import", "--help").out


@pytest.mark.usefixtures("installed")
def test_an_option_that_is_there_already_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def clashing(self: Table, out: str = "") -> None:
        self.scale = 1.0

    monkeypatch.setattr(Table, "__init__", clashing)
    told = complaint("data", "import", "table", "x", "--domain", "a", "--out", "y")
    assert "the option --out is there twice; rename the format's own" in told


@pytest.mark.usefixtures("installed")
def test_what_is_no_format_is_refused() -> None:
    told = complaint("data", "import", "odd", "x", "--domain", "a", "--out", "y")
    assert "entry point 'odd' of plp.formats is <function dumps" in told
