from __future__ import annotations

import pytest
from command import complaint, plp
from samples import add_run
from scipy import stats

from datamodules.errors import ConfigError
from plp_lightning.report.reference import Value, paper, reference


def test_values_are_numbers_pairs_or_what_is_known() -> None:
    content = {"values": {"mine": {"a": 0.5, "b": [0.5, 0.1], "c": {"mean": 0.5, "low": 0.4, "high": 0.6}, "d": 1}}}
    found = reference(content, "own.yaml")
    assert found.value("mine", "a") == Value(mean=0.5)
    assert found.value("mine", "b") == Value(mean=0.5, std=0.1)
    assert found.value("mine", "c").interval(None) == (0.4, 0.6)
    assert found.value("mine", "e") is found.value("other", "a") is None


def test_the_interval_of_a_mean_and_its_spread_is_student_s_within_0_and_1() -> None:
    low, high = Value(mean=0.5, std=0.3).interval(9)
    assert (low, high) == pytest.approx(stats.t.interval(0.95, 8, loc=0.5, scale=0.1))
    assert Value(mean=0.9, std=0.3).interval(4)[1] == 1.0
    assert Value(mean=0.5, std=0.3).interval(None) is Value(mean=0.5, std=0.3).interval(1) is None


def test_unknown_names_come_last_and_their_numbers_are_numbers() -> None:
    names = [("mine", "x_140"), ("mine", "x_28"), ("r2r", "bc"), ("p2p_umaze", "bc"), ("r2r", "plp"), ("mine", "x")]
    assert sorted(names, key=lambda name: paper().rank(*name)) == [
        *(("p2p_umaze", "bc"), ("r2r", "plp"), ("r2r", "bc"), ("mine", "x"), ("mine", "x_28"), ("mine", "x_140")),
    ]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ({}, "values is missing"),
        ({"values": 3}, "values is 3"),
        ({"values": {"a": {"b": [1, 2, 3]}}}, r"values\.a\.b is \[1, 2, 3\]"),
        ({"values": {"a": {"b": 50}}}, r"values\.a\.b\.mean is 50"),
        ({"values": {"a": {"b": float("nan")}}}, r"values\.a\.b\.mean is nan"),
        ({"values": {"a": {"b": {"low": 0.1}}}}, r"values\.a\.b\.mean is missing"),
        ({"values": {"a\x1b": {"b": 1}}}, r"a\\x1b"),
        ({"values": {}, "runs": 0}, "runs is 0"),
        ({"values": {}, "colour": "red"}, "colour is 'red'"),
        ({"values": {}, "tables": [{"title": "x"}]}, r"tables\.0\.experiments is missing"),
    ],
)
def test_what_is_no_reference_is_told(content, told) -> None:
    with pytest.raises(ConfigError, match=rf"^own\.yaml: .*{told}.*; expected name, runs and values"):
        reference(content, "own.yaml")


@pytest.mark.parametrize("text", ["a: [", "- 1", "values: {a: {b: 7}}", "\xff", "values: {a: {b: 1, b: 0}}"])
def test_a_file_that_is_no_reference_is_one_line(tmp_path, text) -> None:
    add_run(tmp_path / "runs")
    file = tmp_path / "own.yaml"
    file.write_bytes(text.encode("latin-1"))
    assert str(file) in complaint("report", tmp_path / "runs", "--reference", file)
    assert "no.yaml" in complaint("report", tmp_path / "runs", "--reference", tmp_path / "no.yaml")


def test_a_reference_of_one_s_own_takes_the_paper_s_place(tmp_path) -> None:
    add_run(tmp_path / "runs")
    file = tmp_path / "own.yaml"
    file.write_text("name: last year\nvalues: {p2p_medium: {plp: [0.4, 0.1]}}\n")
    text = plp("report", tmp_path / "runs", "--reference", file).out
    assert "| before adaptation | last year |" in text
    assert "| 0.40 ± 0.10 |" in text
    assert "the paper" not in text
