from __future__ import annotations

import csv
import dataclasses
import io
import json

import pytest
from command import METHODS, ROOT, complaint, plp

from plp_lightning.report.records import Record, RunKey, read_records
from plp_lightning.report.tables import comma_separated, markdown, paper_values

PAGES = {path.stem for path in (ROOT / "configs").glob("*.yaml")}


def record(method="plp", seed=0, success=0.5, experiment="r2r", target="x0y0h0", alignment=None, **further):
    scores = alignment or {"closeness": 0.5}
    return Record(
        *(RunKey(experiment, method, target, seed), success, 0.25, 0.75, 0.0, None, 1.0, scores, 60.0),
        **{"settings": {}, **further},
    )


def test_methods_stand_side_by_side_in_the_paper_s_order():
    lines = markdown(
        [record("bc"), record("mine"), record(success=0.75), record(success=1.0, seed=1), record(experiment="new")]
    ).splitlines()
    rows = [line for line in lines if line.startswith("| ")]
    assert rows[2:6] == [
        "| r2r | plp | 2 | 0.88 ± 0.18 | 0.00 ± 0.00 | 0.63 ± 0.37 |",
        "| r2r | bc | 1 | 0.50 | 0.00 | 0.22 ± 0.40 |",
        "| r2r | mine | 1 | 0.50 | 0.00 | – |",
        "| new | plp | 1 | 0.50 | 0.00 | – |",
    ]
    assert "| r2r | plp | x0y0h0 | 0 | 0.75 (0.25 – 0.75) | 0.00 | – | 1.00 | closeness 0.50 |" in rows


def test_results_whose_settings_nobody_wrote_down_are_averaged_with_each_other_and_marked():
    older = [record(success=1.0, settings=None), record(success=0.5, seed=1, settings=None)]
    lines = markdown([*older, record(success=0.75, seed=2)]).splitlines()
    assert "| r2r | plp | 2 † | 0.75 ± 0.35 | 0.00 ± 0.00 | 0.63 ± 0.37 |" in lines
    assert "| r2r | plp | 1 | 0.75 | 0.00 | 0.63 ± 0.37 |" in lines
    assert any(line.startswith("† settings not recorded") for line in lines)
    assert "†" not in markdown([record()])


def test_measures_of_behaviour_are_shown_where_there_are_some():
    runs = [record(behaviour={"steps_to_success": 12.5}), record(seed=1)]
    lines = markdown(runs).splitlines()
    assert "| r2r | plp | x0y0h0 | 0 | 0.50 (0.25 – 0.75) | 0.00 | – | 1.00 | closeness 0.50 |" in " ".join(lines)
    assert next(line for line in lines if "| x0y0h0 | 0 |" in line).endswith("| steps_to_success 12.50 |")
    assert next(line for line in lines if "| x0y0h0 | 1 |" in line).endswith("| – |")
    first, second = csv.DictReader(io.StringIO(comma_separated(runs)))
    assert (first["steps_to_success"], second["steps_to_success"]) == ("12.5", "")


def test_csv_has_the_settings_of_each_run():
    known, unknown = csv.DictReader(
        io.StringIO(comma_separated([record(settings={"alignment.lr": 0.5}), record(seed=1, settings=None)]))
    )
    assert json.loads(known["settings"]) == {"alignment.lr": 0.5}
    assert unknown["settings"] == "not recorded"


def test_methods_are_compared_on_the_same_target_task_and_seed():
    runs = [record("gama", success=0.25), record(success=0.75), record("bc", success=0.5)]
    others = [record(seed=1), record(target="x2y2h2"), record("mine", target="x2y2h2", success=1.0)]
    lines = markdown([*runs, *others]).splitlines()
    first = lines.index("## Side by side") + 4
    assert lines[first : first + 5] == [
        "| experiment | target | seed | plp | gama | bc | mine |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| r2r | x0y0h0 | 0 | 0.75 | 0.25 | 0.50 | – |",
        "| r2r | x2y2h2 | 0 | 0.50 | – | – | 1.00 |",
        "",
    ]
    assert "## Side by side" not in markdown([record(), record("gama", seed=1)])


def test_csv_has_a_line_a_run_and_a_column_a_score():
    text = comma_separated([record(alignment={"top1": 0.25, "top5": 0.5}), record(seed=1)])
    first, second = csv.DictReader(io.StringIO(text))
    assert (first["top5"], first["closeness"], second["top5"], second["closeness"]) == ("0.5", "", "", "0.5")
    assert (first["target"], first["success"], first["source"], first["seconds"]) == ("x0y0h0", "0.5", "", "60.0")


def test_the_paper_s_values_name_pages_and_overlays():
    methods = {path.stem for path in METHODS}
    assert set(paper_values()) == PAGES - {"base", "smoke", "r2r_paper"}  # whose values are those of r2r
    for values in paper_values().values():
        assert set(values) <= methods
        assert all(0 <= mean <= 1 and 0 <= deviation <= 0.5 for mean, deviation in values.values())


def test_the_report_of_the_kept_results_is_current(tmp_path):
    results = ROOT / "docs" / "results"
    answer = plp("report", results, "--out", tmp_path)
    assert answer.code == 0, answer
    for name in ("report.md", "report.csv"):
        assert (tmp_path / name).read_text() == (results / name).read_text(), f"plp report {results} --out {results}"
    assert plp("report", results).out == (results / "report.md").read_text()


def test_the_readme_shows_means_of_the_kept_results():
    readme, report = ((ROOT / path).read_text().splitlines() for path in ("README.md", "docs/results/report.md"))
    first = readme.index("| experiment | method | runs | success | before adaptation | the paper |")
    rows = readme[first : readme.index("", first)]
    assert len(rows) == 2 + 9
    for row in rows:
        assert row in report, f"README.md: no row of docs/results/report.md is {row!r}; copy it from there"


@pytest.mark.parametrize("record", read_records([ROOT / "docs" / "results"]), ids=lambda r: "-".join(r.run[1:3]))
def test_kept_results_lie_where_their_names_say(record):
    experiment, method, target, _ = record.run
    assert (ROOT / "docs" / "results" / experiment / method / f"{target}.json").is_file()


def test_mistakes_are_one_line(tmp_path):
    assert "no such file or folder" in complaint("report", tmp_path / "runs")
    assert "see plp report --help" in complaint("report")


def test_runs_without_a_simulator_tell_errors_of_held_out_actions_and_no_success():
    errors = {"held_out": {"flat": 0.01234, "tall": 0.5}, "low": None, "high": None, "before": None, "proxy": None}
    run = dataclasses.replace(record(success=None, experiment="own", alignment={"mix": 0.75}), **errors)
    text = markdown([run, record(), record("bc")])
    assert "| own | plp | 1 | not simulated | – | – |" in text
    row = "| own | plp | x0y0h0 | 0 | not simulated | – | – | – | mix 0.75 | flat 0.0123, tall 0.5000 |"
    assert row in text.splitlines()
    assert "own" not in text[text.index("## Side by side") : text.index("## Runs")]
    simulated, unsimulated = csv.DictReader(io.StringIO(comma_separated([run, record()])))
    assert (unsimulated["success"], unsimulated["error_flat"], unsimulated["mix"]) == ("", "0.01234", "0.75")
    assert (simulated["success"], simulated["error_flat"]) == ("0.5", "")
