"""Wrong and extreme values at every setting that the parser knows: taken, or refused in one line."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command import SMOKE, TINY, plp, tiny_smoke

from datamodules.plain_yaml import dump_yaml, parse_yaml
from plp_lightning.cli import experiments
from plp_lightning.runs.directory import RunDirectory

Place = tuple[str | int, ...]
VALUES: list[Any] = [
    *(None, True, -1, 0, 0.5, -0.5, 10**18, "9" * 5000, "1e400", float("nan"), float("inf"), -float("inf")),
    *("", "word", "x" * 5000, "~", "a: [", "[1", "[red]x[/y]", "a\nb", "os.system", "plp_lightning.cli.main"),
    *([], {}, [1, "x", None], [[[[]]]], {"a": {"b": []}}, {1: 2}, {"init_args": {}}, {"init_args": 3}),
    *(
        {"class_path": 3},
        {"class_path": "Adaptation"},
        {"class_path": "subprocess.Popen", "init_args": {"args": ["x"]}},
    ),
]
CALLBACKS = [
    {"class_path": "EarlyStopping", "init_args": {"monitor": "val/bc"}},
    {"class_path": "StochasticWeightAveraging", "init_args": {"swa_lrs": 1e-3}},
    *({"class_path": name} for name in ("Timer", "EMAWeightAveraging", "LearningRateMonitor")),
]
TRIALS = 25


def places(tree: Any, above: Place = ()) -> Iterator[Place]:
    """Where values stand in a configuration."""
    parts = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in parts:
        yield (*above, key)
        yield from places(value, (*above, key))


def put(tree: Any, place: Place, value: Any) -> None:
    for key in place[:-1]:
        tree = tree[key]
    tree[place[-1]] = value


@pytest.fixture(scope="module")
def resolved() -> str:
    """Every setting with its default, for some callbacks too."""
    answer = plp("fit", *SMOKE, *TINY, "--callbacks", json.dumps(CALLBACKS), "--print_config")
    assert answer.code == 0, answer
    return answer.out


@pytest.fixture(autouse=True)
def untrained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything but the run itself, of which nothing is written."""
    monkeypatch.setattr(RunDirectory, "create", lambda *_: None)
    monkeypatch.setattr(experiments, "_fit", lambda *_: None)


def check(words: list[str], what: object) -> None:
    try:
        answer = plp("fit", *words)
    except Exception as error:
        pytest.fail(f"{what}: {type(error).__name__}: {error}")
    assert answer.code in (0, 2), what
    lines = answer.err.splitlines()
    assert (lines == []) if answer.code == 0 else (len(lines) == 1 and lines[0].startswith("plp: ")), (what, lines)
    assert all(len(line) < 1500 for line in lines), what


@pytest.mark.parametrize("seed", range(2))
def test_files_with_wrong_values_are_taken_or_refused_in_one_line(seed: int, resolved: str, tmp_path: Path) -> None:
    generator, known = random.Random(seed), [*places(parse_yaml(resolved))]
    for _ in range(TRIALS):
        place, value, tree = generator.choice(known), generator.choice(VALUES), parse_yaml(resolved)
        put(tree, place, value)
        (tmp_path / "page.yaml").write_text(dump_yaml(tree))
        check(["--config", str(tmp_path / "page.yaml")], (place, value))


def test_flags_with_wrong_values_are_taken_or_refused_in_one_line(resolved: str, tmp_path: Path) -> None:
    generator, known = random.Random(2), [*places(parse_yaml(resolved))]
    keys = [".".join(x for x in map(str, place) if x != "init_args") for place in known if place[-1] != "init_args"]
    for _ in range(TRIALS):
        key, value = generator.choice(keys), generator.choice(VALUES)
        word = value if isinstance(value, str) else json.dumps(value)
        check([*tiny_smoke(tmp_path), *generator.choice([[f"--{key}={word}"], [f"--{key}", word]])], (key, word))
