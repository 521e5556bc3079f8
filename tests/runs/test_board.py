"""TensorBoard's page of a run: phases one after the other, the main charts, one row of settings, the result table."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command import finished_smoke, plp, smoke_run, tiny_smoke
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2

from plp_lightning.runs.board import Board, Progress, result_table
from plp_lightning.runs.curves import read_rows
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.records import record_hash


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return finished_smoke(tmp_path_factory.mktemp("board"))


def events_of(run: RunDirectory, phase: str) -> EventAccumulator:
    events = EventAccumulator(str(run.phase(phase)))
    events.Reload()
    return events


def steps(run: RunDirectory, phase: str, tag: str = "loss/train/bc") -> list[int]:
    return [event.step for event in events_of(run, phase).Scalars(tag)]


def test_steps_and_epochs_go_on_over_phases_and_not_in_the_file_of_each(run: RunDirectory) -> None:
    first, second = steps(run, "alignment"), steps(run, "adaptation")
    assert first[0] == 0
    assert second[0] == run.phase_record("alignment")["batches"] == first[-1] + 1
    epochs = [event.value for phase in ("alignment", "adaptation") for event in events_of(run, phase).Scalars("epoch")]
    assert sorted({*epochs}) == [0, 1, 2, 3]
    rows = read_rows(run.phase("adaptation") / "metrics.csv")
    assert min(int(step) for step, *_ in rows) == 0
    assert {value for _, name, value in rows if name == "epoch"} == {"0", "1"}


def titles(run: RunDirectory, phase: str) -> list[str]:
    """Titles of the charts on a phase's page of custom scalars."""
    content = events_of(run, phase).Tensors("custom_scalars__config__")[0].tensor_proto.string_val[0]
    (category,) = layout_pb2.Layout.FromString(content).category
    return [chart.title for chart in category.chart]


def test_the_main_charts_come_first(run: RunDirectory) -> None:
    assert titles(run, "alignment") == ["success", "alignment", "held-out loss", "loss"]


def test_a_run_without_scores_has_no_chart_of_them(tmp_path: Path) -> None:
    board = Board(tmp_path, "alignment", Progress(0, 0), None)
    board.show_charts(scored=False)
    board.save()
    assert titles(RunDirectory(tmp_path), "alignment") == ["success", "held-out loss", "loss"]


def test_the_last_phase_has_the_row_of_settings_and_the_table(run: RunDirectory) -> None:
    found = {phase: {*events_of(run, phase).summary_metadata} for phase in ("alignment", "adaptation")}
    for tag in ("_hparams_/session_start_info", "results/text_summary"):
        assert [tag in found[phase] for phase in found] == [False, True]
    (text,) = events_of(run, "adaptation").Tensors("results/text_summary")
    rate = json.loads(run.results.read_text())["target"]["success"]
    assert f"| target task in target domain | {rate:.2f} |" in text.tensor_proto.string_val[0].decode()


def test_a_phase_alone_has_a_row_and_a_table_too(tmp_path: Path) -> None:
    assert plp("fit", *tiny_smoke(tmp_path), "--phase", "alignment").code == 0
    assert "_hparams_/session_start_info" in events_of(smoke_run(tmp_path), "alignment").summary_metadata


def test_a_run_whose_first_phase_is_older_than_the_count_goes_on(run: RunDirectory, tmp_path: Path) -> None:
    shutil.copytree(run.path, tmp_path / "run")
    old = RunDirectory(tmp_path / "run")
    status = old.status()
    for record in status["phases"].values():
        for key in ("batches", "epochs"):
            record.pop(key)
        record["sha256"] = record_hash(record)
    begun = {"state": "preempted", "phases": {"alignment": status["phases"]["alignment"]}}
    old.write_json("status.json", {**status, **begun, "results_sha256": ""})
    old.results.unlink()
    shutil.rmtree(old.phase("adaptation"))
    assert plp("fit", "--resume", old.path).code == 0
    assert steps(old, "adaptation")[0] == 0


def test_without_a_simulator_the_table_says_so() -> None:
    assert result_table({}) == "not simulated"
