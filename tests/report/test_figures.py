"""Figures show what runs have, from their own files, and say what is not there."""

from __future__ import annotations

import io
import json
from collections import defaultdict

import numpy as np
import pytest
from PIL import Image
from samples import RESULT, add_run
from test_tables import record

from datamodules.errors import ConfigError
from plp_lightning.report.charts import _lines, _numbered, study_charts
from plp_lightning.report.composing import figure_section
from plp_lightning.report.progress import _course, progress_charts
from plp_lightning.report.records import read_records
from plp_lightning.report.reference import NOTHING, paper
from plp_lightning.report.snapshots import WIDEST, snapshots
from plp_lightning.report.summaries import groups_of


def shown(records, compared=NOTHING):
    return {figure.title: len(figure.images) for figure in figure_section(records, compared, pytest.fail).figures}


def test_one_s_own_runs_have_their_figures_and_none_of_the_paper_s_empty_ones(tmp_path) -> None:
    add_run(tmp_path, ("latents",), experiment="mine", alignment={"mix": 0.5})
    records = read_records([tmp_path])
    expected = {"Success": 1, "Alignment: mix": 1, "Over epochs": 1, "Latent states": 1}
    assert shown(records) == shown(records, paper()) == expected


def test_the_paper_s_figures_are_told_if_nothing_is_there_for_them() -> None:
    found = shown([record(alignment={"top1": 0.5})], paper())
    assert found["Alignment: Top-1 accuracy"] == 1
    empty = {"Alignment: Top-5 accuracy", "Alignment: Closeness", "Weight of MMD", "Latent states", "Films"}
    assert all(found[title] == 0 for title in empty)


def test_studies_are_found_by_the_numbers_in_names() -> None:
    methods = ["plp_mmd_0.1", "plp_mmd_1.0", "plp_disc_0.01", "plp_t_goals_5", "plp_t_goals_25", "plp_t"]
    runs = [record(method) for method in methods]
    runs += [record("plp_t", experiment=f"p2p_medium_sources_{n}") for n in (2, 3)]
    runs += [record(f"mine_width_{n}") for n in (64, 192)]
    found = {figure.title: bool(figure.images) for figure in study_charts(groups_of(runs, paper()), wanted=False)}
    assert found == {
        "Number of proxy goals": True,
        "Number of source domains": True,
        "Weight of MMD": True,
        "width": True,
    }


def test_one_source_is_the_first_point_of_every_way_to_add_more() -> None:
    runs = [record("plp_t_sources_1", experiment="p2p_medium"), record("bc_sources_1", experiment="p2a_medium")]
    runs += [
        record(f"plp_t_{way}", experiment=f"p2p_medium_sources_{n}") for way in ("growing", "fixed") for n in (2, 3)
    ]
    points = defaultdict(dict)
    for group in groups_of(runs, paper()):
        for _, line, number in _numbered(group):
            points[line][number] = group
    lines = _lines(points)
    assert {name: sorted(found) for name, found in lines.items()} == {
        "plp_t_growing on p2p_medium": [1, 2, 3],
        "plp_t_fixed on p2p_medium": [1, 2, 3],
    }


def test_curves_go_on_over_phases_and_end_with_the_final_evaluation(tmp_path) -> None:
    add_run(tmp_path)
    (record,) = read_records([tmp_path])
    course = _course(record, pytest.fail)
    assert course.begins == [0, 2]
    assert course.curves["eval/target_success"] == [(1, 0.25), (2, 0.1), (3, 0.25), (4, 0.5)]
    assert course.curves["eval/source_success"] == [(4, 0.75)]
    assert course.curves["alignment/top5"] == [(1, 0.5), (3, 0.5)]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e300", "-5"])
def test_values_that_no_axis_has_are_no_reason_to_fail(tmp_path, value) -> None:
    place = add_run(tmp_path)
    (place / "alignment" / "metrics.csv").write_text(f"step,metric,value\n1,alignment/top5,{value}\n1,epoch,0\n")
    assert len(progress_charts(groups_of(read_records([tmp_path]), NOTHING), pytest.fail).images) == 1


@pytest.mark.parametrize(
    "text",
    [
        "a\nx\n",
        "a\n1,epoch,x\n",
        "a\n\x00\n",
        "a\n1,epoch,inf\n",
        "a\n1,epoch,nan\n",
        "a\n1,epoch,-7\n",
        "a\n1,epoch,1e99\n",
    ],
)
def test_damaged_curves_are_told_and_left_away(tmp_path, text) -> None:
    add_run(tmp_path)
    place = add_run(tmp_path, seed=1)
    (place / "alignment" / "metrics.csv").write_text(text)
    told = list[str]()
    figure = progress_charts(groups_of(read_records([tmp_path]), NOTHING), told.append)
    assert len(figure.images) == 1  # of the other run
    (line,) = told
    assert line.endswith("its curves are left away")
    assert str(place / "alignment" / "metrics.csv") in line


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"GIF89a", b"<svg/>", b"half"])
def test_damaged_pictures_are_told_and_left_away(tmp_path, content) -> None:
    place = add_run(tmp_path, ("latents", "paths"))
    whole = (place / "adaptation" / "paths.png").read_bytes()
    (place / "adaptation" / "paths.png").write_bytes(whole[: len(whole) // 2] if content == b"half" else content)
    told = list[str]()
    figures = snapshots(groups_of(read_records([tmp_path]), NOTHING), False, told.append)
    assert [figure.title for figure in figures] == ["Latent states"]
    (line,) = told
    assert f"{place / 'adaptation' / 'paths.png'}: no picture" in line


def test_pictures_are_not_larger_than_a_page_and_hold_nothing_but_what_is_seen(tmp_path) -> None:
    place = add_run(tmp_path, ("latents",))
    large = Image.fromarray(np.zeros((10, 4000, 3), np.uint8))
    file = place / "adaptation" / "latents.png"
    large.save(file)
    file.write_bytes(file.read_bytes() + b"<script>")
    (figure,) = snapshots(groups_of(read_records([tmp_path]), NOTHING), False, pytest.fail)
    assert Image.open(io.BytesIO(figure.images[0].png)).size[0] == WIDEST
    assert b"<script>" not in figure.images[0].png


def test_figures_are_the_same_bytes_each_time(tmp_path) -> None:
    add_run(tmp_path)
    add_run(tmp_path, method="plp_t")
    first, second = (figure_section(read_records([tmp_path]), paper(), pytest.fail) for _ in range(2))
    assert first == second
    assert all(image.pdf for figure in first.figures for image in figure.images)


def test_a_phase_s_name_leads_nowhere_else(tmp_path) -> None:
    place = add_run(tmp_path)
    for name in ("../..", "..", "/etc", "", ".", 3, None):
        (place / "results.json").write_text(json.dumps(RESULT | {"phases": [name]}))
        with pytest.raises(ConfigError, match="for a phase"):
            read_records([tmp_path])
