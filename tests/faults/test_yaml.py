"""YAML of anyone's is plain data or one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from command import ROOT, complaint, plp, tiny_smoke
from hypothesis import given
from hypothesis import strategies as st

from datamodules.plain_yaml import dump_yaml, parse_yaml

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
)
LONG_CHAIN = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 60))
HOSTILE = [
    (BOMB.encode(), "values, 14 levels; more than"),
    (BOMB.replace("a11: &a11", "callbacks: &a11").encode(), "values, 14 levels; more than"),
    (LONG_CHAIN.encode(), "62 levels; more than"),
    (b"[" * 5000 + b"]" * 5000, "more than 50 levels"),
    ("".join(" " * i + "a:\n" for i in range(900)).encode(), "levels"),
    (b"a: &a\n  <<: *a\n", "an alias stands for what it is a part of, line 1"),
    (b"score: &a [*a]", "an alias stands for what it is a part of, line 1"),
    (b"seed: 1\nseed: 2\n", "'seed' is set twice, line 2"),
    (b"data: {seed: 1, seed: 1}", "'seed' is set twice, line 1"),
    (b'experiment: "a\\0b"', "holds a control character, line 1"),
    (b'experiment: "\\e[31m"', "holds a control character, line 1"),
    (b"\x00\x01\x02", "is no YAML"),
    (b"a: gr\xf6\xdfe", "is no UTF-8 text (byte 0xf6 in line 1); save it in that encoding"),
    ("a: 1".encode("utf-16"), "is no UTF-8 text (byte 0xff in line 1)"),
    (b"# " + b"x" * (1 << 20), "holds more than 1048576 bytes"),
    (b"a: 1\n---\nb: 2", "is no YAML (expected a single document"),
    (b"on: 1", "a key is no word; put it in quotes, line 1"),
    (b"? [a]\n: 1", "a key is no word; put it in quotes, line 1"),
    (b"a: !!binary aGk=", "could not determine a constructor"),
    (b"a: !!set {b}", "could not determine a constructor"),
    (b"seed: " + b"9" * 5000, "expected a whole number from 0 to 4294967295"),
    (b"seed: 1:30:00", "seed is 1:30:00; expected a whole number"),
    (b"seed: 2024-01-01", "seed is 2024-01-01; expected a whole number"),
    (b"data: null", "data is None; expected keys and values"),
    (b"policy: 3", "policy"),
    (b"alignment: 3", "alignment is 3; expected a class"),
    (b"alignment: {init_args: 3}", "alignment.init_args is 3; expected keys and values"),
    (b"alignment: {init_args: {terms: 3}}", "alignment.terms is 3; expected names, each with a class"),
    (b"alignment: {class_path: [3]}", "alignment.class_path is [3]; expected a class"),
    (b"phases: null", "phases is None; expected a list of names"),
    (b"domains: null", "domains is None; expected keys and values"),
]


@pytest.mark.parametrize(("content", "told"), HOSTILE, ids=lambda value: str(value)[:40])
def test_a_hostile_page_is_one_line(content: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_bytes(content)
    line = complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", tmp_path / "page.yaml")
    assert told in line
    assert len(line) < 700
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("content", ["", "# nothing\n", "\ufeffseed: 3\r\n"])
def test_pages_with_nothing_or_marks_of_editors_are_read(content: str, tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_text(content, encoding="utf-8", newline="")
    answer = plp("fit", *tiny_smoke(tmp_path / "runs"), "--config", tmp_path / "page.yaml", "--print_config")
    assert answer.code == 0, answer
    assert ("seed: 3" in answer.out) == ("seed" in content)


def test_an_unknown_key_beside_names_that_have_changed_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_text("data: {target: goal_2, batch_sise: 3}")
    assert "batch_sise" in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", tmp_path / "page.yaml")
    (tmp_path / "page.yaml").write_text("data: {target: goal_2}\ntrainer: {devices: 300}")
    assert "trainer.devices" in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", tmp_path / "page.yaml")


def test_aliases_and_merged_keys_are_what_they_stand_for() -> None:
    assert parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: *a") == {"a": {"x": 1}, "b": {"x": 1, "y": 2}, "c": {"x": 1}}


def test_words_that_look_like_times_stay_words() -> None:
    assert parse_yaml("[12:00:00:00, 2024-01-01, 010, 1e-3, 1_000]") == ["12:00:00:00", "2024-01-01", "010", 1e-3, 1000]


PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**40), 10**40)
    | st.floats(allow_nan=False)
    | st.text(st.characters(min_codepoint=32, max_codepoint=126)).filter(lambda text: not text.startswith("~"))
    | st.sampled_from(["1e-3", "010", "12:00:00", "on", "", "null", "2024-01-01", ".inf", "<<", "1_0", "0x1"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abc"), inner),
    max_leaves=8,
)


@given(PLAIN)
def test_what_is_written_is_read_as_the_same(data: Any) -> None:
    assert parse_yaml(dump_yaml(data)) == data


@pytest.mark.parametrize("page", sorted((ROOT / "configs").rglob("*.yaml")), ids=lambda path: path.stem)
def test_our_pages_are_read_as_any_reader_would(page: Path) -> None:
    assert parse_yaml(page.read_text()) == yaml.safe_load(page.read_text())
