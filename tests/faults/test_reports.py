"""Damaged and foreign files below the folders of a report: one line, refused or left away; never a traceback."""

from __future__ import annotations

import json
import os
import sys

import pytest
from command import ROOT, complaint, plp

sys.path.insert(0, str(ROOT / "tests" / "report"))
from samples import CURVES, NASTY, RESULT, add_run

TARGET = {"success": 0.5, "episodes": 100, "invalid": 0, "interval": [0.4, 0.6], "before": 0.1}


@pytest.mark.parametrize(
    "changes",
    [
        {"target": TARGET | {"success": float("nan")}},
        {"target": TARGET | {"success": 1.5}},
        {"target": TARGET | {"success": -0.5}},
        {"target": TARGET | {"interval": [0.4]}},
        {"target": TARGET | {"interval": [0.4, float("inf")]}},
        {"target": TARGET | {"before": "x"}},
        {"target": TARGET | {"steps": float("inf")}},
        {"target": TARGET | {"episodes": []}},
        {"source": {"success": 2}},
        {"proxy": {}},
        {"alignment": {"top5": float("nan")}},
        {"alignment": [1]},
        {"seconds": {"alignment": "x"}},
        {"settings": [1]},
        {"seed": "x"},
        {"seed": None},
        {"experiment": "\x1b]0;x\x07"},
        {"phases": 3},
        {"phases": ["../../secret"]},
        {"held_out": {"a": []}},
        {"held_out": 3},
    ],
)
def test_results_that_no_run_writes_are_refused_by_their_name(tmp_path, changes) -> None:
    place = add_run(tmp_path / "runs")
    (place / "results.json").write_text(json.dumps(RESULT | changes))
    assert "results.json: not a run's results" in complaint("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_further_keys_and_odd_texts_of_results_are_no_reason_to_fail(tmp_path) -> None:
    odd = {"commit": ["a"], "config_sha256": 3, "data_sha256": {"a": 1}, "settings": {"a": {"b": [NASTY]}, "": None}}
    add_run(tmp_path / "runs", **odd, alignment={NASTY: 0.5, "": 0.25}, target_task=NASTY, held_out={NASTY: 1.0})
    answer = plp("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert (answer.code, answer.err) == (0, "")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"name,experiment\na,b\n",
        b"\xff\xfe",
        b"\x00" * 100,
        b"name,experiment,method,target,seed,success,settings,note\na,b\n",
        b'name,experiment,method,target,seed,success,settings,note\n"' + b"x" * 200_000,
        b"name,experiment,method,target,seed,success,settings,note\na,b,c,d,e,f,g,h,i,j\n",
    ],
)
def test_a_table_of_the_same_name_that_is_another_is_passed_over(tmp_path, content) -> None:
    add_run(tmp_path / "runs")
    (tmp_path / "runs" / "runs.csv").write_bytes(content)
    (tmp_path / "runs" / "more").mkdir()
    (tmp_path / "runs" / "more" / "runs.csv").mkdir()
    answer = plp("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert (answer.code, answer.err) == (0, "")


def test_what_is_damaged_beside_good_results_is_told_once_and_left_away(tmp_path) -> None:
    place = add_run(tmp_path / "runs", ("latents", "film"))
    (place / "adaptation" / "latents.png").write_bytes(b"none")
    (place / "alignment" / "metrics.csv").write_bytes(CURVES.encode()[:-3] + b"\n\xff\n")
    answer = plp("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert answer.code == 0
    assert sorted(line.rpartition("; ")[2] for line in answer.err.splitlines()) == [
        *("it is left away", "its curves are left away")
    ]
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.timeout(60)
def test_what_can_not_be_opened_is_passed_over(tmp_path) -> None:
    place = add_run(tmp_path / "runs")
    (place / "adaptation" / "latents.png").mkdir()
    (place / "adaptation" / "film.png").symlink_to("film.png")
    for name in ("adaptation/paths.png", "other.json", "runs.csv"):  # whose reader would wait for ever
        os.mkfifo(place / name)
    (place / "alignment" / "metrics.csv").unlink()
    (place / "alignment" / "metrics.csv").mkdir()
    answer = plp("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert answer.code == 0
    assert all(line.startswith("plp: ") for line in answer.err.splitlines())


@pytest.mark.parametrize("taken", ["out", "out/figures", "out/report.md/x"])
def test_a_place_that_can_not_be_written_is_one_line(tmp_path, taken) -> None:
    add_run(tmp_path / "runs")
    (tmp_path / taken).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / taken).write_text("mine")
    complaint("report", tmp_path / "runs", "--out", tmp_path / "out")
    assert (tmp_path / taken).read_text() == "mine"
