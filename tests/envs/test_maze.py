from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest

from datamodules.errors import ConfigError
from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze

MAZES = {
    "PointMaze_UMaze-v3": lambda: PointMaze("umaze", frame="gymnasium"),
    "PointMaze_Medium-v3": lambda: PointMaze("medium", frame="gymnasium"),
    "AntMaze_UMaze-v4": lambda: WalkerMaze("umaze", frame="gymnasium"),
    "AntMaze_Medium-v4": lambda: WalkerMaze("medium", frame="gymnasium"),
}


def environment(name: str):
    """Gymnasium-Robotics' own environment, and the body inside it that has ``model`` and ``data``."""
    from gymnasium_robotics.envs.maze import ant_maze_v4, maps, point_maze

    family = point_maze.PointMazeEnv if name.startswith("Point") else ant_maze_v4.AntMazeEnv
    env = family(maze_map=maps.U_MAZE if "UMaze" in name else maps.MEDIUM_MAZE)
    return env, env.point_env if name.startswith("Point") else env.ant_env


@pytest.mark.parametrize("name", MAZES)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_equals_gymnasium_robotics_step_by_step(name):
    import mujoco

    maze: Maze = MAZES[name]()
    env, body = environment(name)
    first = maze.reset([maze.tasks.names[5]], [3]).state[0]
    env.reset(seed=0)
    mujoco.mj_resetData(body.model, body.data)
    size = body.model.nq
    # The simulator's own start in double precision: the observation has been rounded.
    start = maze.frame.centres(maze._start(maze.layout.starts(maze.layout.task(maze.tasks.names[5])), 3))
    body.set_state(np.r_[start, body.init_qpos[2:]], np.zeros(body.model.nv))
    np.testing.assert_array_equal(first[:size], body.data.qpos.astype(np.float32))
    rng, touched = np.random.default_rng(1), 0
    action = rng.uniform(-1, 1, body.model.nu).astype(np.float32)
    for t in range(500):
        if t % 20 == 0 or name.startswith("Ant"):  # the point must keep going to meet a wall
            action = rng.uniform(-1.2, 1.2, body.model.nu).astype(np.float32)
        seen = env.step(np.clip(action.astype(float), -1, 1))[0]
        expected = seen["observation"] if "Point" in name else np.r_[seen["achieved_goal"], seen["observation"]]
        step = maze.step(action[None], np.array([0]))
        np.testing.assert_array_equal(step.observation.state[0], expected.astype(np.float32))
        touched += body.data.ncon > (1 if "Point" in name else 0)
    assert touched > 10, "contacts are part of the comparison"
    env.close()


def episode(maze: Maze, tasks: list[str], seeds: list[int], steps: int = 15) -> np.ndarray:
    """States ``(T, E, O)`` under random actions that depend on the seed alone."""
    size = maze.spec("a").action_size
    actions = np.stack([np.random.default_rng(seed).uniform(-1, 1, (steps, size)) for seed in seeds], axis=1)
    states = [maze.reset(tasks, seeds).state]
    states += [maze.step(action, np.arange(len(tasks))).observation.state for action in actions]
    return np.stack(states)


@pytest.mark.parametrize("kind", [PointMaze, WalkerMaze])
def test_episode_depends_on_its_task_and_seed_alone(kind):
    tasks, seeds = ["s0_g_3_1", "s1_g_1_1", "s2_g_2_3", "s0_g_3_1"], [4, 5, 6, 7]
    together = episode(kind("umaze", threads=2), tasks, seeds)
    np.testing.assert_array_equal(together[:, ::-1], episode(kind("umaze", threads=1), tasks[::-1], seeds[::-1]))
    np.testing.assert_array_equal(together[:, [2]], episode(kind("umaze"), tasks[2:3], seeds[2:3]))
    assert (together[0, 0, :2] != together[0, 3, :2]).all(), "seeds seed"


def test_episodes_may_stop_one_by_one():
    maze = PointMaze("umaze")
    everyone = episode(maze, ["s0_g_3_1", "s1_g_1_1"], [4, 5], steps=6)[-1]
    size, states = maze.spec("a").action_size, None
    actions = np.stack([np.random.default_rng(seed).uniform(-1, 1, (6, size)) for seed in (4, 5)], axis=1)
    maze.reset(["s0_g_3_1", "s1_g_1_1"], [4, 5])
    for action in actions:
        states = maze.step(action[[1]], np.array([1])).observation.state
    np.testing.assert_array_equal(states[0], everyone[1])


def test_source_of_p2p_is_a_swapped_and_negated_copy():
    target, source = PointMaze("umaze"), PointMaze("umaze", swap_axes=True, negate_actions=True)
    first = target.reset(["s0_g_3_1"], [2]).state
    np.testing.assert_array_equal(source.reset(["s0_g_3_1"], [2]).state, first[:, [1, 0, 3, 2]])
    action = np.array([[0.5, -0.25]])
    after = target.step(action, np.array([0])).observation.state
    np.testing.assert_array_equal(source.step(-action, np.array([0])).observation.state, after[:, [1, 0, 3, 2]])
    np.testing.assert_allclose(source.shared_position(after[:, [1, 0, 3, 2]]), target.shared_position(after))


def test_d4rl_frames_by_hand():
    point, ant = PointMaze("medium", jitter=0), WalkerMaze("medium", jitter=0)
    task = "s2_g_6_6"
    row, column = np.rint(point.shared_position(point.reset([task], [0]).state))[0]
    np.testing.assert_allclose(point.reset([task], [0]).state[0, :2], [row - 0.2, column - 0.2], atol=1e-6)
    np.testing.assert_allclose(ant.reset([task], [0]).state[0, :2], [4 * (column - 1), 4 * (row - 1)], atol=1e-6)


@pytest.mark.parametrize("frame", ["d4rl", "gymnasium"])
@pytest.mark.parametrize("kind", [PointMaze, WalkerMaze])
def test_starts_lie_in_the_zone_and_off_the_goal(kind, frame):
    maze = kind("medium", frame=frame)
    tasks = [task for task in maze.tasks.names for _ in range(3)]
    cells = maze.shared_position(maze.reset(tasks, range(len(tasks))).state)
    assert np.abs(cells - np.rint(cells)).max() <= 0.25 + 1e-6
    for name, cell in zip(tasks, np.rint(cells).astype(int), strict=True):
        assert tuple(cell) in maze.layout.starts(maze.layout.task(name))


def place(maze: Maze, cell: tuple[float, float]) -> None:
    """Put episode 0 somewhere, at rest."""
    maze._physics.states[0, maze._physics.qpos][:2] = maze.frame.centres(np.array(cell))


def test_success_is_half_a_cell_around_the_goal():
    maze = PointMaze("umaze")
    still = np.zeros((1, 2)), np.array([0])
    maze.reset(["s0_g_3_3"], [0])
    place(maze, (3, 2.49))
    assert not maze.step(*still).success[0]
    place(maze, (3, 2.51))
    assert maze.step(*still).success[0]


def test_detour_counts_only_by_the_long_way():
    maze = PointMaze("medium")
    still = np.zeros((1, 2)), np.array([0])
    maze.reset(["detour_6_1"], [0])
    place(maze, (6, 1))
    assert not maze.step(*still).success[0]
    for cell in maze.layout.via(maze.layout.task("detour_6_1")):
        place(maze, cell)
        assert not maze.step(*still).success[0]
    place(maze, (6, 1))
    assert maze.step(*still).success[0]
    maze.reset(["detour_6_1"], [0])
    place(maze, (6, 1))
    assert not maze.step(*still).success[0], "a new episode has visited nothing"


def test_action_that_is_not_finite_ends_its_episode_only():
    maze = PointMaze("umaze")
    before = maze.reset(["s0_g_3_3", "s0_g_3_3"], [0, 1]).state
    step = maze.step(np.array([[np.nan, 0.0], [1.0, 0.0]]), np.array([0, 1]))
    assert step.invalid.tolist() == [True, False]
    np.testing.assert_array_equal(step.observation.state[0], before[0])
    assert step.observation.state[1, 2] > 0


def test_actions_are_clipped():
    maze = PointMaze("umaze")
    maze.reset(["s0_g_3_3", "s0_g_3_3"], [0, 0])
    states = maze.step(np.array([[3.0, -9.0], [1.0, -1.0]]), np.array([0, 1])).observation.state
    np.testing.assert_array_equal(states[0], states[1])


@pytest.mark.parametrize(
    ("maze", "states", "actions", "hz"),
    [(PointMaze("umaze"), 4, 2, 100), (WalkerMaze("umaze"), 29, 8, 20), (WalkerMaze("umaze", legs=6), 37, 12, 20)],
    ids=["point", "ant", "spider"],
)
def test_spec_tells_what_is_observed(maze, states, actions, hz):
    spec = maze.spec("domain")
    assert (spec.state_size, spec.action_size, spec.control_hz) == (states, actions, hz)
    assert maze.reset(["s0_g_3_3"], [0]).state.shape == (1, states)
    assert spec.columns(["position"]) == [0, 1]


def test_quat_is_where_the_spec_says():
    maze = WalkerMaze("umaze", legs=6)
    first = maze.reset(["s0_g_3_3"], [0]).state[0]
    np.testing.assert_allclose(first[maze.spec("spider").columns(["height", "quat"])], [0.75, 1, 0, 0, 0])


def test_horizon_of_the_layout_unless_told():
    assert (PointMaze("umaze").horizon, PointMaze("medium").horizon) == (250, 400)
    assert (WalkerMaze("umaze").horizon, WalkerMaze("medium", horizon=7).horizon) == (700, 7)


def test_unknown_layout_is_named():
    with pytest.raises(ConfigError, match=r"unknown maze layout 'large'; expected one of: umaze, medium"):
        PointMaze("large")


def test_can_be_pickled_before_the_first_reset():
    maze = pickle.loads(pickle.dumps(WalkerMaze("medium", legs=6)))
    assert maze.reset(["s0_g_1_1"], [0]).state.shape == (1, 37)


def test_listing_tasks_needs_no_physics():
    code = (
        "import sys; from plp_lightning.envs.maze.simulator import PointMaze;"
        "PointMaze('medium').tasks.proxies('goal_6_6');"
        "sys.exit(bool({'mujoco', 'numba', 'networkx', 'torch'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
