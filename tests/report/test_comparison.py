"""The paper's tables: its value, runs by the recipe that it prints, and ours, with what they were made by."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from pathlib import Path

from command import plp
from samples import add_run
from test_tables import record, section

TABLE_1 = "Methods (the paper's Table 1)"


def test_rows_have_the_paper_s_value_what_the_literal_recipe_came_to_and_ours() -> None:
    measured = dataclasses.replace(record(success=0.99), low=0.95, high=1.0)
    literal = record("plp_literal", success=0.5, recipe="literal")
    rows = section(TABLE_1, measured, literal, record("bc", experiment="mine"))
    assert len(rows) == 9 * 6
    ours, others = "0.99 ▲<br>0.95 – 1.00 episodes<br>1 run", "0.50<br>0.25 – 0.75 episodes<br>1 run"
    assert f"| r2r | plp | 0.63 ± 0.37 | {others} | {ours} |" in rows
    missing = "not run: 0.1 h for 9 runs"  # of runs of a minute
    assert f"| r2r | plp_t | 0.71 ± 0.21 | {missing} | {missing} |" in rows
    unknown = "not run: hours unknown"
    assert f"| p2a_ood | plp | – | {unknown} | {unknown} |" in rows  # of which the paper has no value


def test_values_with_runs_are_counted_by_recipe() -> None:
    ours = [record(success=0.99, seed=seed) for seed in range(9)] + [record("bc", seed=seed) for seed in range(3)]
    others = [record("plp_adapt_best"), record("bc", experiment="mine"), record("plp_t", success=None)]
    rows = section("What was run of 92 values of the paper", *ours, *others, record("plp_literal", recipe="literal"))
    assert rows == ["| literal | 1 | 0 | 0 |", "| ours | 2 | 2 | 1 |"]


def test_hours_of_missing_runs_are_those_of_the_same_method_or_else_of_the_same_experiment() -> None:
    rows = section(TABLE_1, record(seconds=3600.0), record("bc", seconds=7200.0))
    hours = {row.split(" | ")[1]: re.findall(r"not run: ([\d.]+) h", row) for row in rows if row.startswith("| r2r")}
    assert (hours["plp"], hours["bc"], hours["gama"]) == (["9.0"], ["18.0"], ["13.5", "13.5"])


def test_the_sweep_s_page_and_the_commit_of_its_runs_stand_in_a_row_and_in_its_csv(tmp_path: Path) -> None:
    add_run(tmp_path / "runs", method="plp_literal", commit="c0ffee", recipe="literal", sweep="evidence_c")
    add_run(tmp_path / "runs", commit="badc0de", sweep="evidence_a")
    assert plp("report", tmp_path / "runs", "--out", tmp_path).code == 0
    rows = csv.reader(io.StringIO((tmp_path / "tables.csv").read_text()))
    (row,) = [row for row in rows if row[:3] == [TABLE_1, "p2p_medium", "plp"]]
    measured = "0.50 ▼ · 0.40 – 0.60 episodes · 1 run"
    assert row[3:] == ["0.93 ± 0.05", measured, measured, "evidence_c · evidence_a", "c0ffee · badc0de"]
    runs = {row["sweep"]: row for row in csv.DictReader(io.StringIO((tmp_path / "report.csv").read_text()))}
    assert (runs["evidence_c"]["recipe"], runs["evidence_a"]["recipe"]) == ("literal", "")
    assert "evidence_c" in (tmp_path / "report.html").read_text()


def test_runs_of_a_recipe_are_compared_with_the_value_of_their_method_and_with_ours() -> None:
    runs = [record(success=0.75), record("plp_literal", success=0.25, recipe="literal")]
    assert [row.split(" | ")[-1] for row in section("Success rates", *runs)] == ["0.63 ± 0.37 |"] * 2
    assert section("Differences", *runs) == ["| r2r | plp_literal − plp | 1 | −0.50 |"]
