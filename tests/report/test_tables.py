from __future__ import annotations

import csv
import dataclasses
import io
import json
import re

import pytest
from command import METHODS, ROOT, complaint, plp

from plp_lightning.report.composing import TITLE, table_sections
from plp_lightning.report.markdown import markdown
from plp_lightning.report.records import Record, RunKey, read_records
from plp_lightning.report.reference import paper, reference
from plp_lightning.report.sheet import comma_separated

PAGES = {path.stem for path in (ROOT / "configs").glob("*.yaml")}
RESULTS = ROOT / "docs" / "results"


def record(method="plp", seed=0, success=0.5, experiment="r2r", target="x0y0h0", alignment=None, **further):
    scores = alignment or {"closeness": 0.5}
    return Record(
        *(RunKey(experiment, method, target, seed), success, 0.25, 0.75, 0.0, None, 1.0, scores),
        **{"seconds": 60.0, "settings": {}, "episodes": 100, **further},
    )


def lines(*records, compared=None, kept=()):
    return markdown(TITLE, table_sections(records, kept, compared or paper())).splitlines()


def section(title, *records, **further):
    """Rows of a section's table, without its header."""
    found = lines(*records, **further)
    begin = found.index(f"## {title}")
    end = next((i for i in range(begin + 1, len(found)) if found[i].startswith("## ")), len(found))
    return [line for line in found[begin:end] if line.startswith("| ")][2:]


def test_methods_stand_side_by_side_in_the_paper_s_order():
    runs = [record("bc"), record("mine"), record(success=0.75), record(success=1.0, seed=1), record(experiment="new")]
    assert section("Success rates", *runs) == [
        "| r2r | plp | 2 | 0.88 ± 0.18 seeds | 0.75 – 1.00 runs | 0.00 ± 0.00 seeds | 0.63 ± 0.37 |",
        "| r2r | bc | 1 | 0.50 | 0.25 – 0.75 episodes | 0.00 | 0.22 ± 0.40 |",
        "| r2r | mine | 1 | 0.50 | 0.25 – 0.75 episodes | 0.00 | – |",
        "| new | plp | 1 | 0.50 | 0.25 – 0.75 episodes | 0.00 | – |",
    ]
    assert "| r2r | plp | x0y0h0 | 0 | 0.75 (0.25 – 0.75) | 0.00 | – | 1.00 | closeness 0.50 |" in section(
        "Runs", *runs
    )


def test_spreads_over_seeds_and_over_targets_are_told_apart_and_without_two_seeds_none_is_told():
    targets = [record(success=0.5), record(success=1.0, target="x2y2h2")]
    (row,) = section("Success rates", *targets)
    assert row.startswith("| r2r | plp | 2 | 0.75 ± 0.35 targets | 0.69 – 0.80 episodes | 0.00 ± 0.00 targets |")
    (row,) = section(
        "Success rates", *targets, record(success=0.7, seed=1), record(success=0.9, seed=1, target="x2y2h2")
    )
    assert "| 0.78 ± 0.11 seeds ± 0.25 targets |" in row
    assert "runs |" in row
    (row,) = section("Success rates", *targets, record(success=0.7, seed=1))  # one target has one seed alone
    assert "seeds ±" in row
    assert "episodes |" in row
    paper_s = {row for table in paper().tables for row in section(table.title, *targets)}
    for text in lines(*targets):
        ours = text.split(" | ")[3:] if text in paper_s else [text.rpartition(" | ")[0]] * ("the paper" not in text)
        for found in re.findall(r"± ?[\d.]+ ?(\w*)", " | ".join(ours)):
            assert found in ("seeds", "targets"), text


def test_results_whose_settings_nobody_wrote_down_are_averaged_with_each_other_and_marked():
    older = [record(success=1.0, settings=None), record(success=0.5, seed=1, settings=None)]
    rows = section("Success rates", *older, record(success=0.75, seed=2))
    assert any(row.startswith("| r2r | plp | 2 † | 0.75 ± 0.35 seeds |") for row in rows)
    assert any(row.startswith("| r2r | plp | 1 | 0.75 |") for row in rows)
    assert any(line.startswith("† settings not recorded") for line in lines(*older))
    assert not any("†" in line for line in lines(record()))


def test_every_table_of_the_paper_is_there_and_of_one_s_own_experiments_none():
    titles = [line for line in lines(record()) if re.fullmatch(r"## .* \(the paper's Table \d\)", line)]
    assert len(titles) == 6
    own = lines(record(experiment="mine"), record("bc", experiment="mine"))
    assert not [line for line in own if "paper" in line or "not run" in line]


def test_a_table_of_the_paper_may_have_a_value_of_its_own():
    rows = section("State input of the decoder (the paper's Table 4)", record())
    assert any("| v2v_reach | plp_t | 0.68 ± 0.24 | not run" in row for row in rows)


def test_values_of_one_s_own_are_compared_with_by_their_intervals():
    content = {
        "name": "last year",
        "runs": 3,
        "values": {"mine": {"plp": {"mean": 0.1, "low": 0.0, "high": 0.2}, "bc": 0.5}},
    }
    content["tables"] = [{"title": "Ours", "experiments": ["mine"], "methods": ["plp", "gama"]}]
    runs = [record(experiment="mine"), record("bc", experiment="mine")]
    own = reference(content, "own.yaml")
    assert section("Success rates", *runs, compared=own) == [
        "| mine | plp | 1 | 0.50 | 0.25 – 0.75 episodes | 0.00 | 0.10 (0.00 – 0.20) ▲ |",
        "| mine | bc | 1 | 0.50 | 0.25 – 0.75 episodes | 0.00 | 0.50 |",
    ]
    measured = "0.50 ▲<br>0.25 – 0.75 episodes<br>1 run"
    assert section("Ours", *runs, compared=own) == [
        f"| mine | plp | 0.10 (0.00 – 0.20) | {measured} |",
        "| mine | gama | – | not run: 0.1 h for 3 runs |",
    ]


def test_measures_of_behaviour_are_shown_where_there_are_some():
    runs = [record(behaviour={"steps_to_success": 12.5}), record(seed=1)]
    first, second = section("Runs", *runs)
    assert first.endswith("| closeness 0.50 | steps_to_success 12.50 |")
    assert second.endswith("| – |")
    assert section("Behaviour", *runs) == ["| r2r | plp | 2 | 12.50 |"]
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
    found = lines(*runs, *others)
    first = found.index("## Side by side") + 4
    assert found[first : first + 5] == [
        "| experiment | target | seed | plp | gama | bc | mine |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| r2r | x0y0h0 | 0 | 0.75 | 0.25 | 0.50 | – |",
        "| r2r | x2y2h2 | 0 | 0.50 | – | – | 1.00 |",
        "",
    ]
    assert "## Side by side" not in lines(record(), record("gama", seed=1))


def test_differences_are_of_pairs_alone():
    runs = [
        record(success=0.5),
        record(success=0.7, seed=1),
        record("bc", success=0.1),
        record("bc", success=0.5, seed=1),
    ]
    alone = [record("gama", success=0.9, seed=1), record("cdil", success=0.9, seed=7)]
    assert section("Differences", *runs, *alone) == [
        "| r2r | gama − plp | 1 | +0.20 |",
        "| r2r | bc − plp | 2 | −0.30 (−1.57 – +0.97) |",
    ]
    assert "## Differences" not in lines(record(), record("bc", seed=1))


def test_interquartile_means_are_told_of_two_seeds_or_more_of_every_target():
    runs = [record(success=value, seed=i) for i, value in enumerate((0.0, 0.5, 0.75, 1.0))]
    (row,) = section("Over seeds", *runs)
    assert row.startswith("| r2r | plp | 4 | 0.62 (")
    rows = section("Over seeds", *runs, *(record(experiment="p2p_ood", seed=seed, success=1.0) for seed in (0, 1)))
    assert rows[-1].startswith("| all of these | plp | 6 |")
    assert "## Over seeds" not in lines(*runs, record(target="x2y2h2"))


def test_the_worst_seed_is_that_of_all_target_tasks_together():
    rates = {("x0y0h0", 0): 0.2, ("x2y2h2", 0): 1.0, ("x0y0h0", 1): 0.9, ("x2y2h2", 1): 0.1}
    runs = [record(success=rate, target=target, seed=seed) for (target, seed), rate in rates.items()]
    assert section("Over seeds", *runs)[0].endswith(" | 0.57 | 0.50 |")
    further = record(success=0.0, seed=2)  # has not been run on the other one
    assert section("Over seeds", *runs, further)[0].endswith(" | 0.50 |")
    apart = [
        record(success=0.5, seed=seed, target=target) for target in "ab" for seed in (1, 2, 3)[target == "b" :][:2]
    ]
    assert section("Over seeds", *apart)[0].endswith(" | – |")  # seed 2 alone has both


def test_csv_has_a_line_a_run_and_a_column_a_score():
    text = comma_separated([record(alignment={"top1": 0.25, "top5": 0.5}), record(seed=1)])
    first, second = csv.DictReader(io.StringIO(text))
    assert (first["top5"], first["closeness"], second["top5"], second["closeness"]) == ("0.5", "", "", "0.5")
    assert (first["target"], first["success"], first["source"], first["seconds"]) == ("x0y0h0", "0.5", "", "60.0")


def test_runs_that_no_table_quotes_have_a_table_of_their_own():
    kept = [dict.fromkeys(("name", "experiment", "method", "target", "seed", "success", "settings", "note"), "")]
    kept[0]["name"] = "r2r_tried"
    assert section("Runs on the way", record(), kept=kept) == ["| r2r_tried" + " | –" * 7 + " |"]


def test_the_paper_s_values_name_pages_and_overlays():
    methods = {path.stem for path in METHODS}
    # The paper knows nothing of these.
    ours = {"door_open_views", "lift_panda_to_ur5e", "stack_sawyer_to_panda", "two_arms"}
    assert set(paper().values) == PAGES - {"base", "smoke", "r2r_paper"} - ours  # r2r_paper's values are those of r2r
    for values in paper().values.values():
        assert set(values) <= methods
        assert all(value.std is not None and value.std <= 0.5 for value in values.values())


def test_the_paper_s_tables_name_what_it_has_values_of():
    for table in paper().tables:
        missing = [(e, m) for e in table.experiments for m in table.methods if not paper().value(e, m, table)]
        assert all(e == "p2a_ood" or (e, m) == ("r2r", "plp_proprio") for e, m in missing), table.title


def test_the_report_of_the_kept_results_is_current(tmp_path):
    answer = plp("report", RESULTS, "--out", tmp_path)
    assert answer.code == 0, answer
    for name in ("report.md", "report.csv"):
        told = "plp report docs/results --out docs/results"
        assert (tmp_path / name).read_text() == (RESULTS / name).read_text(), told
    shown = re.findall(r"\(figures/(.*?)\)", (RESULTS / "report.md").read_text())
    assert shown
    for name in shown:
        assert (RESULTS / "figures" / name).is_file()
        assert (tmp_path / "figures" / name).is_file()
    tables = plp("report", RESULTS).out.splitlines()
    assert not {*tables} - {*(RESULTS / "report.md").read_text().splitlines()}


def test_the_readme_shows_means_of_the_kept_results():
    readme, report = ((ROOT / path).read_text().splitlines() for path in ("README.md", "docs/results/report.md"))
    header = "| experiment | method | runs | success | 95 % interval | before adaptation | the paper |"
    first = readme.index(header)
    rows = readme[first : readme.index("", first)]
    assert len(rows) == 2 + 9
    for row in rows:
        assert row in report, f"README.md: no row of docs/results/report.md is {row!r}; copy it from there"


@pytest.mark.parametrize("record", read_records([ROOT / "docs" / "results"]), ids=lambda r: "-".join(r.run[1:3]))
def test_kept_results_lie_where_their_names_say(record):
    experiment, method, target, seed = record.run
    name = target.replace(" ", "_") + (f"_seed_{seed}" if seed else "")
    assert (ROOT / "docs" / "results" / experiment / method / f"{name}.json").is_file()


def test_mistakes_are_one_line(tmp_path):
    assert "no such file or folder" in complaint("report", tmp_path / "runs")
    assert "see plp report --help" in complaint("report")


def test_runs_without_a_simulator_tell_errors_of_held_out_actions_and_no_success():
    errors = {"held_out": {"flat": 0.01234, "tall": 0.5}, "low": None, "high": None, "before": None, "proxy": None}
    run = dataclasses.replace(record(success=None, experiment="own", alignment={"mix": 0.75}), **errors)
    runs = [run, record(), record("bc")]
    assert "| own | plp | 1 | not simulated | – | – | – |" in section("Success rates", *runs)
    assert section("Held-out actions", *runs) == ["| own | plp | 1 | 0.0123 | 0.5000 |"]
    row = "| own | plp | x0y0h0 | 0 | not simulated | – | – | – | mix 0.75 | flat 0.0123, tall 0.5000 |"
    assert row in section("Runs", *runs)
    assert not any("own" in row for row in section("Side by side", *runs))
    unsimulated, simulated = csv.DictReader(io.StringIO(comma_separated([run, record()])))
    assert (unsimulated["success"], unsimulated["error_flat"], unsimulated["mix"]) == ("", "0.01234", "0.75")
    assert (simulated["success"], simulated["error_flat"]) == ("0.5", "")
