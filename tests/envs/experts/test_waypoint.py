from __future__ import annotations

import numpy as np
import pytest

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs.base import Expert
from plp_lightning.envs.experts.waypoint import Guide, WaypointExpert
from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze


def at(maze: Maze, *cells: tuple[float, float]) -> np.ndarray:
    """States at rest at these fractional cells."""
    return np.pad(maze.frame.centres(np.array(cells)), ((0, 0), (0, 2)))


def solved(maze: Maze, expert: Expert, tasks: list[str], seeds: list[int]) -> np.ndarray:
    """Which episodes the expert ends with success."""
    observation, running = maze.reset(tasks, seeds), np.arange(len(tasks))
    expert.begin(maze, tasks, seeds)
    success = np.zeros(len(tasks), dtype=bool)
    for _ in range(maze.horizon):
        step = maze.step(expert.act(observation, running), running)
        success[running[step.success]] = True
        over = step.success | step.invalid
        observation, running = step.observation.take(~over), running[~over]
        if len(running) == 0:
            break
    return success


def test_aims_by_hand():
    maze = PointMaze("umaze")
    guide = Guide(maze, ["s0_g_3_1"], width=0.4)  # from (1, 1) right, right, down, down, left, left
    places = {
        (1.0, 1.0): (1.0, 2.0),  # on the line: the next centre
        (1.0, 1.2): (1.0, 2.0),
        (1.1, 1.2): (1.0, 1.8),  # a quarter of the width beside it: three quarters of the remaining way
        (1.4, 1.2): (1.0, 1.2),  # beyond the width: the line
        (1.0, 2.6): (1.0, 3.0),  # enters the corner beside the way down: the line, which is the corner's centre
        (3.2, 1.4): (3.0, 1.0),  # the goal's cell: its centre
    }
    aims = guide.aims(at(maze, *places), np.zeros(len(places), dtype=int))
    np.testing.assert_allclose(aims, list(places.values()), atol=1e-6)


def test_aims_change_gradually_along_the_way():
    maze = PointMaze("umaze")
    guide = Guide(maze, ["s0_g_3_1"])
    way = np.concatenate([[(1.02, c) for c in np.linspace(1, 3, 400)], [(r, 2.98) for r in np.linspace(1, 3, 400)]])
    ahead = guide.aims(at(maze, *map(tuple, way)), np.zeros(len(way), dtype=int)) - way
    headings = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    assert np.linalg.norm(np.diff(headings[:400], axis=0), axis=1).max() < 0.1
    assert np.linalg.norm(np.diff(headings[400:], axis=0), axis=1).max() < 0.1


def test_controller_by_hand():
    maze, expert = PointMaze("umaze"), WaypointExpert(gain=0.5, damping=0.25)
    expert.begin(maze, ["s0_g_3_1"], [0])
    state = at(maze, (1.0, 1.0))
    state[0, 2:] = 0.2, -0.4
    # The aim is one cell to the right, +y in D4RL's frame.
    force = expert.act(Observation(state), np.array([0]))
    np.testing.assert_allclose(force, [[-0.25 * 0.2, 0.5 * 1.0 + 0.25 * 0.4]], atol=1e-6)


@pytest.mark.parametrize("frame", ["d4rl", "gymnasium"])
@pytest.mark.parametrize("shifted", [False, True])
def test_source_and_target_of_p2p_are_demonstrated(frame, shifted):
    maze = PointMaze("umaze", swap_axes=shifted, negate_actions=shifted, frame=frame)
    tasks = list(maze.tasks.names) * 3
    assert solved(maze, WaypointExpert(), tasks, list(range(len(tasks)))).all()


def test_every_task_of_medium_is_solved_and_detours_by_the_long_way():
    maze = PointMaze("medium")
    tasks = [*maze.tasks.names, *["detour_6_1", "detour_6_2", "detour_3_2"] * 5]
    success = solved(maze, WaypointExpert(), tasks, list(range(len(tasks))))
    assert success.all(), [task for task, done in zip(tasks, success, strict=True) if not done]


def test_short_way_to_the_goal_is_no_detour():
    class ShortWay(WaypointExpert):
        def begin(self, simulator, tasks, seeds):
            super().begin(simulator, [task.replace("detour", "s0_g") for task in tasks], seeds)

    maze = PointMaze("medium")
    assert not solved(maze, ShortWay(), ["detour_6_1"] * 4, [0, 1, 2, 3]).any()


def test_expert_needs_its_own_maze():
    with pytest.raises(ConfigError, match=r"WaypointExpert demonstrates in PointMaze, not in WalkerMaze; give the"):
        WaypointExpert().begin(WalkerMaze("umaze"), ["s0_g_3_1"], [0])
