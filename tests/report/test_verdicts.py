"""A report's table of verdicts."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples import NASTY, add_run
from test_tables import lines, record, section

from datamodules.errors import ConfigError
from plp_lightning.report.records import read_records

MIXED, APART = {"mix": 0.5, "learnt": 1.0}, {"mix": 0.1, "cloned/ant": 0.5, "cloned/point": 0.7}
SHORT = ("cloned/ant", "cloned/point", "mix")


def test_runs_are_counted_by_their_verdicts_and_by_what_falls_short() -> None:
    runs = [
        *(record(seed=seed, success=rate, facts=MIXED) for seed, rate in enumerate((1.0, 0.8, 0.79, 1.0))),
        record("gama", success=0.2, facts={"cloned/ant": 1.0}),
        record("bc_only", success=0.0, facts=APART, falls_short=SHORT),
        record("bc_only", success=0.9, seed=1, facts=APART, falls_short=("mix",)),
        record("bc", success=1.0),  # older than verdicts
        record("cdil", success=None, facts=MIXED),  # not simulated
    ]
    assert section("Verdicts", *runs) == [
        "| aligned | 4 | 0.75 | 0.30 – 0.95 |",
        "| nothing falls short, no latent space | 1 | 0.00 | 0.00 – 0.79 |",
        "| falls short | 2 | 0.50 | 0.09 – 0.91 |",
        "| falls short: cloned | 1 | 0.00 | 0.00 – 0.79 |",
        "| falls short: mix | 2 | 0.50 | 0.09 – 0.91 |",
    ]


def test_without_verdicts_there_is_no_table() -> None:
    assert "## Verdicts" not in lines(record(), record(success=None, facts=MIXED, seed=1))


def test_verdicts_are_read_from_results(tmp_path: Path) -> None:
    add_run(tmp_path, facts={**MIXED, "spread": None}, falls_short=[f"{NASTY}/ant"])
    (found,) = read_records([tmp_path])
    assert found.facts == MIXED
    (_, row) = section("Verdicts", found)
    assert row.startswith("| falls short: ")
    assert "script" in row
    assert "<script>" not in row


@pytest.mark.parametrize("wrong", [{"facts": [1]}, {"facts": {"mix": "much"}}, {"falls_short": 3}])
def test_verdicts_that_no_run_writes_are_refused(tmp_path: Path, wrong: dict[str, object]) -> None:
    add_run(tmp_path, **{"facts": MIXED, **wrong})
    with pytest.raises(ConfigError, match=r"results.json: not a run's results"):
        read_records([tmp_path])
