from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection, PatchCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from plp_lightning.envs.views import FloorPlan
from plp_lightning.pictures.paths import FAILED, SOLVED, Panel, Paths, path_figure

PLAN = FloorPlan(
    np.array([[0.0, 0], [0, 1], [0, 2], [0, 3], [2, 3]]),
    side=1.0,
    goals={"near": (1.0, 2.0), "far": (2.0, 0.0), "unused": (9.0, 9.0)},
    radius=0.25,
)
LINES = (
    np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]),
    np.array([[1.0, 1.0], [2.0, 0.0]]),
    np.array([[2.0, 1.0], [1.5, 1.0]]),
)
PATHS = Paths(("near", "far", "near"), LINES, np.array([True, True, False]))


def drawn(figure: Figure, panel: int = 0) -> dict[str, LineCollection]:
    lines = [artist for artist in figure.axes[panel].collections if isinstance(artist, LineCollection)]
    return {str(artist.get_label()): artist for artist in lines}


def test_solved_and_failed_paths_differ_in_colour_and_are_counted() -> None:
    found = drawn(path_figure([Panel("there", PLAN, PATHS)]))
    assert {label: len(lines.get_segments()) for label, lines in found.items()} == {"solved (2)": 2, "failed (1)": 1}
    assert SOLVED != FAILED
    # Columns to the right, rows downwards.
    np.testing.assert_array_equal(found["failed (1)"].get_segments()[0], [[1, 2], [1, 1.5]])
    np.testing.assert_array_equal(found["solved (2)"].get_segments()[0], [[0, 1], [1, 1], [2, 1]])


def test_walls_are_drawn_whole_and_as_the_maze_is_written() -> None:
    (axes,) = path_figure([Panel("there", PLAN, PATHS)]).axes
    (walls,) = (artist for artist in axes.collections if isinstance(artist, PatchCollection))
    corners = {tuple(path.vertices.min(axis=0)) for path in walls.get_paths()}
    assert corners == {(-0.5, -0.5), (0.5, -0.5), (1.5, -0.5), (2.5, -0.5), (2.5, 1.5)}
    assert (axes.get_xlim(), axes.get_ylim()) == ((-0.5, 3.5), (2.5, -0.5))


def test_goals_of_the_tasks_starts_and_failed_ends_are_marked() -> None:
    (axes,) = path_figure([Panel("there", PLAN, PATHS)]).axes
    circles = {(*patch.center, patch.radius) for patch in axes.patches if isinstance(patch, Circle)}
    assert circles == {(2.0, 1.0, 0.25), (0.0, 2.0, 0.25)}
    marks = {str(artist.get_label()): artist for artist in axes.collections if isinstance(artist, PathCollection)}
    assert {tuple(place) for place in marks["goal"].get_offsets()} == {(2.0, 1.0), (0.0, 2.0)}
    assert marks["start"].get_offsets().tolist() == [[0, 1], [1, 1], [1, 2]]
    (ends,) = (artist for label, artist in marks.items() if label.startswith("_"))
    assert ends.get_offsets().tolist() == [[1, 1.5]]


def test_every_panel_says_what_it_shows() -> None:
    all_failed = Paths(PATHS.tasks, PATHS.positions, np.zeros(3, dtype=bool))
    figure = path_figure([Panel("goal_1 in target domain: ant", PLAN, PATHS), Panel("other", PLAN, all_failed)])
    assert [axes.get_title() for axes in figure.axes] == [
        "goal_1 in target domain: ant\n2 of 3 episodes solved",
        "other\n0 of 3 episodes solved",
    ]
    legends = [{text.get_text() for text in axes.get_legend().get_texts()} for axes in figure.axes]
    assert legends == [
        {"goal", "solved (2)", "failed (1)", "start"},
        {"goal", "solved (0)", "failed (3)", "start"},
    ]
