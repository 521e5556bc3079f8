"""``plp list`` tells what there is, and the short help of ``plp fit`` where the rest is."""

from __future__ import annotations

import re

import pytest
from command import ROOT, complaint, plp

from plp_lightning.cli.listing import CLASSES, FOLDERS, KINDS


def listed(*words: str) -> dict[str, str]:
    answer = plp("list", *words)
    assert answer.code == 0, answer
    return {name: told.strip() for name, _, told in (line.partition("  ") for line in answer.out.splitlines())}


@pytest.mark.parametrize(("kind", "folder"), [("experiments", "."), ("methods", "methods"), ("sweeps", "sweeps")])
def test_every_page_is_listed_with_a_line(kind: str, folder: str) -> None:
    pages = {page.stem for page in (ROOT / "configs" / folder).glob("*.yaml")} - {"base"}
    found = listed(kind)
    assert {*found} == pages
    assert all(found.values())


def test_classes_are_listed_by_the_names_that_pages_have() -> None:
    assert {"Gymnasium", "Lift", "LinearPoint", "PointMaze", "Reach", "WalkerMaze", "Window"} <= {*listed("simulators")}
    assert {"MetaWorld", "Robosuite"} <= {*listed("simulators")}
    assert not {"Simulator", "Tabletop", "Suite"} & {*listed("simulators")}
    assert "L_MMD" in listed("terms")["MMD"]
    assert not [told for kind in KINDS if kind != "tasks" for told in listed(kind).values() if ":func:" in told]


def test_alone_it_lists_what_can_be_listed() -> None:
    assert {*FOLDERS, *CLASSES, "tasks"} == {*KINDS}
    lines = plp("list").out.splitlines()
    assert [line.split()[2] for line in lines] == [*KINDS]
    assert all(plp(*line.split()[1:3]).code == 0 for line in lines)


def test_tasks_are_those_of_the_experiment() -> None:
    assert [*listed("tasks", "smoke")] == [f"goal_{i}" for i in range(8)]
    assert listed("tasks", "smoke")["goal_3"] == "the page's target"
    assert listed("tasks", "p2p_umaze")["goal_2_3"].startswith("3 tasks: ")
    assert "nowhere" in complaint("list", "tasks", "nowhere")
    assert "invalid choice: 'robots'" in complaint("list", "robots")


def test_help_of_fit_is_a_screen_and_names_no_key_that_is_not_there() -> None:
    brief, whole = (plp("fit", "--help", *more).out for more in ([], ["all"]))
    assert len(brief.splitlines()) <= 45
    assert max(map(len, brief.splitlines())) <= 120
    nested = ("--alignment.", "--adaptation.", "--policy.")  # settings of classes, which their own help shows
    keys = {key for key in re.findall(r"--[a-z][\w.]+\w", brief) if not key.startswith(nested)}
    assert len(keys) > 15
    assert not [key for key in keys if not re.search(rf"{re.escape(key)}\b", whole)]
