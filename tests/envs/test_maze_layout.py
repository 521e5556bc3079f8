from __future__ import annotations

import numpy as np
import pytest

from datamodules.errors import ConfigError
from plp_lightning.envs.maze.layout import LAYOUTS, Cell, Frame, Layout, MazeTask


def walk(layout: Layout, task: MazeTask, start: Cell) -> list[Cell]:
    path, route = [start], layout.route(task)
    while path[-1] != task.goal:
        path.append(route[path[-1]])
    return path


def flood(layout: Layout, goal: Cell) -> dict[Cell, int]:
    """Distances to the goal by relaxing until nothing changes: slow, and knows no graph library."""
    distance = {cell: 0 if cell == goal else 99 for cell in layout.cells}
    for _ in layout.cells:
        for (i, j), old in distance.items():
            near = [distance.get(c, 99) for c in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1))]
            distance[i, j] = min(old, 1 + min(near))
    return distance


def test_cells_and_tasks_are_as_many_as_in_the_paper():
    umaze, medium = LAYOUTS["umaze"], LAYOUTS["medium"]
    assert (len(umaze.cells), len(medium.cells)) == (7, 26)
    assert len(umaze.tasks.names) == 21
    assert len([task for task in medium.by_name.values() if not task.avoid]) == 104
    assert len(umaze.tasks.proxies("goal_1_1")) == 18
    assert len(medium.tasks.proxies("goal_6_6")) == 100


@pytest.mark.parametrize("name", LAYOUTS)
def test_drawings_are_those_of_gymnasium_robotics(name):
    from gymnasium_robotics.envs.maze import maps

    reference = {"umaze": maps.U_MAZE, "medium": maps.MEDIUM_MAZE}[name]
    assert [[int(mark == "#") for mark in row] for row in LAYOUTS[name].rows] == reference


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_zones_share_out_the_free_cells(layout):
    assert sorted(cell for zone in layout.zones for cell in zone) == sorted(layout.cells)
    assert all(layout.starts(task) for task in layout.by_name.values())
    assert all(task.goal not in layout.starts(task) for task in layout.by_name.values())


def test_medium_zones_are_its_quadrants():
    assert [len(zone) for zone in LAYOUTS["medium"].zones] == [6, 6, 7, 7]
    assert LAYOUTS["medium"].zones[1] == ((1, 5), (1, 6), (2, 4), (2, 5), (2, 6), (3, 4))


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_routes_are_shortest_paths(layout):
    for task in layout.by_name.values():
        if not task.avoid:
            distance = flood(layout, task.goal)
            assert all(len(walk(layout, task, cell)) - 1 == distance[cell] for cell in layout.cells)


def test_detour_goes_the_other_way_round_the_loop():
    medium = LAYOUTS["medium"]
    task = medium.task("detour_6_1")
    path = walk(medium, task, (1, 1))
    assert path[-9:] == [(3, 2), (3, 3), (3, 4), (4, 4), (5, 4), (5, 3), (6, 3), (6, 2), (6, 1)]
    assert medium.via(task) == {(3, 4), (4, 4), (5, 4), (5, 3), (6, 3), (6, 2)}
    assert walk(medium, task, (4, 2))[1] == (3, 2), "from the forbidden cell back to the detour"


def test_no_short_way_meets_a_detour():
    medium = LAYOUTS["medium"]
    for task in medium.detours:
        for start in medium.starts(task):
            long, short = walk(medium, task, start), walk(medium, task._replace(avoid=None), start)
            assert len(long) > len(short)
            assert medium.via(task) <= set(long)
            assert medium.via(task).isdisjoint(short)


def test_target_is_a_goal_a_detour_or_a_task():
    umaze, medium = LAYOUTS["umaze"], LAYOUTS["medium"]
    assert umaze.tasks.of("goal_3_1") == ("s0_g_3_1", "s1_g_3_1", "s2_g_3_1")
    assert medium.tasks.of("detour_6_1") == ("detour_6_1",)
    assert umaze.tasks.of("s1_g_3_1") == ("s1_g_3_1",)


@pytest.mark.parametrize("target", ["goal_6_1", "detour_6_1", "s2_g_6_1"])
def test_proxies_are_short_ways_to_other_goals(target):
    medium = LAYOUTS["medium"]
    proxy_tasks = medium.tasks.proxies(target)
    assert len(proxy_tasks) == 100
    assert all(medium.task(name).goal != (6, 1) and not medium.task(name).avoid for name in proxy_tasks)


def test_unknown_names_are_answered_with_known_ones():
    umaze = LAYOUTS["umaze"]
    with pytest.raises(ConfigError, match=r"no task 's9_g_1_1' in this maze; .* 21 from s0_g_1_1 to .*'s\d_g_1_1'\?"):
        umaze.task("s9_g_1_1")
    with pytest.raises(ConfigError, match=r"no target 'goal_2_1' in this maze; .* from goal_1_1 to .*'goal_\d_\d'\?"):
        umaze.tasks.of("goal_2_1")


def test_gymnasium_frame_by_hand():
    frame = Frame.gymnasium((5, 5), 4.0)
    cells = np.array([[1, 1], [2, 2], [3.5, 1]])
    np.testing.assert_allclose(frame.centres(cells), [[-4, 4], [0, 0], [-4, -6]])
    np.testing.assert_allclose(frame.cells(frame.centres(cells)), cells)


def test_nearest_cell_is_in_the_drawing():
    cells = np.array([[1.4, 1.6], [-3, 2], [9.0, 4.6]])
    np.testing.assert_array_equal(LAYOUTS["umaze"].nearest(cells), [[1, 2], [0, 2], [4, 4]])
