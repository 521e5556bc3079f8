"""``script/bench``: things take turns, bars hold or not, and a benchmark that crashes or hangs costs its own rows."""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import running
from benchmarks.__main__ import main
from benchmarks.catalogue import BENCHMARKS, CPU, Benchmark
from benchmarks.measuring import Options, Row, at_least, at_most, in_turn, ratio
from benchmarks.running import run


def good(options: Options) -> Iterator[Row]:
    yield Row("good", [1.0, 2.0, 3.0], bar=at_most(2.0))


def far_off(options: Options) -> Iterator[Row]:
    yield Row("far off", [6.0], bar=at_most(2.0))


def crashing(options: Options) -> Iterator[Row]:
    yield Row("before", [1.0])
    os.abort()


def raising(options: Options) -> Iterator[Row]:
    yield Row("before", [1.0])
    raise RuntimeError("no such thing")


def hanging(options: Options) -> Iterator[Row]:
    yield Row("before", [1.0])
    time.sleep(60)


@pytest.fixture
def ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Benchmarks of this file in the place of the real ones, by the names of their functions."""
    monkeypatch.setattr(running, "HEAVY", [])
    for function in (good, far_off, crashing, raising, hanging):
        monkeypatch.setitem(BENCHMARKS, function.__name__, Benchmark(__name__, function.__name__))


def test_ways_take_turns_and_the_first_rounds_count_for_nothing() -> None:
    called, ways = [], {name: lambda name=name: called.append(name) or float(len(called)) for name in "ab"}
    assert in_turn(ways, rounds=2, warm=1) == {"a": [3.0, 5.0], "b": [4.0, 6.0]}
    assert called == ["a", "b"] * 3


def test_ratios_are_those_of_each_round() -> None:
    row = ratio("a / b", {"a": [2.0, 30.0, 4.0], "b": [1.0, 10.0, 1.0]}, "a", "b", at_most(3.0))
    assert [*row.values] == [2.0, 3.0, 4.0]
    assert (row.value, row.verdict, row.seconds) == (3.0, "ok", {"a": 4.0, "b": 1.0})


@pytest.mark.parametrize(("bar", "value", "eased"), [(at_most(1.0), 2.0, "ok"), (at_least(5.0), 2.4, "ok")])
def test_short_forms_have_wide_margins(bar: object, value: float, eased: str) -> None:
    row = Row("x", [value], bar=bar)  # type: ignore[arg-type]
    assert (row.verdict, row.eased(2.5).verdict) == ("missed", eased)


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time passes once the first row is there, however long a busy machine takes for it."""
    stands_still = itertools.repeat(0.0, 2)
    monkeypatch.setattr(running, "time", SimpleNamespace(monotonic=lambda: next(stands_still, 601.0)))


@pytest.mark.parametrize(
    ("name", "told"), [("crashing", "has died"), ("raising", "no such thing"), ("hanging", "stopped after 600 s")]
)
def test_a_benchmark_that_ends_badly_keeps_the_rows_before(
    ours: None, request: pytest.FixtureRequest, name: str, told: str
) -> None:
    if name == "hanging":
        request.getfixturevalue("hurried")
    before, after = run(name, Options())
    assert (before.name, before.value, after.verdict) == ("before", 1.0, "failed")
    assert told in after.note


@pytest.mark.parametrize(("names", "code"), [(["good"], 0), (["good", "far_off"], 1), (["crashing", "good"], 1)])
def test_exit_code_and_json_tell_what_was_found(ours: None, tmp_path: Path, names: list[str], code: int) -> None:
    file = tmp_path / "rows.json"
    assert main([*names, "--json", str(file), "--short"]) == code
    written = json.loads(file.read_text())
    assert written["commit"] is None or len(written["commit"]) >= 40
    assert {"processor", "cores", "load", "load_after", "versions"} <= written.keys()
    assert "good" in [row["benchmark"] for row in written["rows"] if row["verdict"] == "ok"]


@pytest.mark.parametrize("words", [["nothing"], ["--device", "cuda", "--json", "x.json"], ["loader", "--many"]])
def test_what_is_not_there_is_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_its_python_robomimic_is_not_run() -> None:
    assert {row.verdict for row in BENCHMARKS["robomimic"].rows(Options())} == {"not run"}


def test_every_benchmark_is_there() -> None:
    for benchmark in BENCHMARKS.values():
        benchmark.rows(Options())  # nothing is measured before the first row is asked for
    assert sum(benchmark.short for benchmark in CPU.values()) >= 5
