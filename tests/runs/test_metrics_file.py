from __future__ import annotations

from pathlib import Path

import pytest

from plp_lightning.runs.metrics_file import MetricsFile, read_rows


def lines(folder: Path) -> list[str]:
    return (folder / "metrics.csv").read_text().splitlines()


def test_every_value_is_a_line(tmp_path: Path) -> None:
    log = MetricsFile(tmp_path / "alignment")
    log.log_metrics({"train/bc": 0.25, "epoch": 0}, 4)
    log.log_metrics({"train/bc": 1 / 3}, 9)
    assert lines(tmp_path / "alignment") == [
        "step,metric,value",
        "4,train/bc,0.25",
        "4,epoch,0",
        "9,train/bc,0.333333333",
    ]
    assert (log.name, log.version) == ("alignment", "")


def test_a_resumed_run_drops_what_it_will_log_again(tmp_path: Path) -> None:
    first = MetricsFile(tmp_path)
    for step in (4, 9, 14):
        first.log_metrics({"train/bc": step, "val/bc": -step}, step)
    resumed = MetricsFile(tmp_path)
    resumed.log_metrics({"train/bc": 90}, 9)
    resumed.log_metrics({"val/bc": 91}, 9)
    expected = [("4", "train/bc", "4"), ("4", "val/bc", "-4"), ("9", "train/bc", "90"), ("9", "val/bc", "91")]
    assert [tuple(row) for row in read_rows(tmp_path / "metrics.csv")] == expected


@pytest.mark.parametrize("cut", ["9", "9,train/bc", "9,"])
def test_half_a_line_of_a_killed_run_is_dropped(tmp_path: Path, cut: str) -> None:
    (tmp_path / "metrics.csv").write_text(f"step,metric,value\n4,train/bc,0.5\n{cut}")
    MetricsFile(tmp_path).log_metrics({"train/bc": 0.25}, 14)
    assert lines(tmp_path) == ["step,metric,value", "4,train/bc,0.5", "14,train/bc,0.25"]


def test_no_file_has_no_rows(tmp_path: Path) -> None:
    assert read_rows(tmp_path / "metrics.csv") == []
