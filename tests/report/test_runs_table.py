"""``docs/results/runs.csv``: a row for every run that was kept, and nothing quoted that it does not have."""

from __future__ import annotations

import csv
import fnmatch
import json
import re
from pathlib import Path

import pytest
from command import ROOT

from plp_lightning.report.records import Record, read_records

RESULTS = ROOT / "docs" / "results"
PAGES = {path.stem for path in (ROOT / "configs").glob("*.yaml")}
DOCS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAME = re.compile(r"`(\*?(?:[pav]2[pasv]|r2r)_[\w.*]+|\*_\w+_\*)`")
"""What a page quotes of the table: a row's name, or a pattern of several."""


def rows() -> list[dict[str, str]]:
    with (RESULTS / "runs.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def quotes(text: str) -> set[str]:
    return {name for name in NAME.findall(text) if name not in PAGES}


def missing(text: str) -> set[str]:
    names = [row["name"] for row in rows()]
    return {quoted for quoted in quotes(text) if not fnmatch.filter(names, quoted)}


def test_rows_have_names_of_their_own_and_say_what_they_were_made_with() -> None:
    names = [(row["name"], row["seed"]) for row in rows()]
    assert len(set(names)) == len(names) > 0
    for row in rows():
        assert None not in row, f"{row['name']}: a cell too many"
        assert row["settings"], f"{row['name']}: say 'not recorded' if nobody knows"
        assert 0 <= float(row["low"]) <= float(row["success"]) <= float(row["high"]) <= 1
        assert float(row["seconds"]) > 0
        assert all(0 <= float(pair.split("=")[1]) <= 1 for pair in row["scores"].split())


@pytest.mark.parametrize("doc", DOCS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_name_that_a_page_quotes_is_a_row(doc) -> None:
    assert missing(doc.read_text(encoding="utf-8")) == set()


def test_a_quoted_name_without_a_row_would_be_found() -> None:
    text = "`p2p_medium_nobody_ran_this`, `r2r_gama_*`, `r2r_nobody_*`, `p2p_medium` and `r2r_disc_raw`"
    assert missing(text) == {"p2p_medium_nobody_ran_this", "r2r_nobody_*"}
    assert sum(len(quotes(doc.read_text(encoding="utf-8"))) for doc in DOCS) > 50


def test_pages_that_rows_are_quoted_in_exist() -> None:
    for row in rows():
        for page in row["quoted_in"].split():
            assert (ROOT / page).is_file(), f"{row['name']}: {page}"


def test_kept_results_have_their_rows() -> None:
    table = {(row["name"], row["seed"]): row for row in rows()}
    kept = {("/".join(record.run[:3]), str(record.run.seed)): record for record in read_records([RESULTS])}
    assert {key for key in table if "/" in key[0]} == set(kept)
    for key, record in kept.items():
        row = table[key]
        for measure in ("before", "source", "proxy"):
            value = getattr(record, measure)
            assert row[measure] == ("" if value is None else str(value)), f"{key}: {measure}"
        assert float(row["success"]) == (told_beside(record) if record.success is None else record.success), key


def told_beside(record: Record) -> float:
    """Success of a run without simulators, which was measured afterwards and stands in a file beside its results."""
    file = RESULTS / Path(record.file).relative_to(RESULTS.name).with_suffix(".episodes.json")
    success: float = json.loads(file.read_text())["success"]
    return success


def test_results_that_were_measured_with_other_settings_than_meant_say_so() -> None:
    for row in rows():
        meant = "_meant_" in row["name"] or re.search(r" by (evidence_[a-z]|table\d)\b", row["settings"])
        touched = row["method"].split("_")[0] in ("gama", "cdil", "contextual") and not meant
        assert touched == row["note"].endswith(("to be measured again", "has been measured again")), row["name"]
