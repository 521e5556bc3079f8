"""R2R-Lift against robosuite's own loop, and the promises of a simulator: purity, validity, quiet imports."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import textwrap
from functools import cache, partial
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
import pytest

from datamodules.errors import UserError
from plp_lightning.envs.lift.robots import Robot
from plp_lightning.envs.lift.simulator import Lift
from plp_lightning.envs.lift.tasks import TASKS, block_place

ROOT = Path(__file__).parents[2]
ROBOTS: tuple[Robot, ...] = get_args(Robot)
KEYS = ("joint_pos_cos", "joint_pos_sin", "joint_vel", "eef_pos", "eef_quat", "gripper_qpos", "gripper_qvel")
EPISODES = [("x0y1h2", 3), ("x2y2h0", 3), ("x1y0h1", 8), ("x0y0h0", 0), ("x2y0h2", 5), ("x1y1h1", 6)]


@cache
def simulator(robot: Robot, threads: int = 1) -> Lift:
    """A simulator that the tests share, since each reset begins anew."""
    return Lift(robot, threads=threads)


def begin(lift: Lift, episodes: list[tuple[str, int]]) -> np.ndarray:
    """Reset to ``(task, seed)`` pairs and return the first states ``(E, O)``."""
    return lift.reset([task for task, _ in episodes], [seed for _, seed in episodes]).state


def run(lift: Lift, episodes: list[tuple[str, int]], actions: np.ndarray) -> np.ndarray:
    """States ``(T + 1, E, O)`` under ``actions (T, E, 4)``."""
    first, rows = begin(lift, episodes), np.arange(len(episodes))
    return np.stack([first, *(lift.step(action, rows).observation.state for action in actions)])


def random_actions(steps: int, episodes: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.2, 1.2, (steps, episodes, 4))


def test_tasks_span_the_grid() -> None:
    tasks = Lift("Sawyer").tasks.names
    assert len(tasks) == 27
    assert (tasks[0], tasks[1], tasks[-1]) == ("x0y0h0", "x0y0h1", "x2y2h2")
    np.testing.assert_allclose(block_place("x0y2h1"), [-0.08, 0.12, 0.87])
    np.testing.assert_allclose(block_place("x2y1h0"), [0.08, 0.0, 0.82])


@pytest.mark.parametrize("target", ["x0y0h0", "x1y1h1", "x2y1h0"])
def test_proxies_share_neither_height_nor_position(target: str) -> None:
    at, places = block_place(target), {task: block_place(task) for task in TASKS.names}
    apart = {task for task, place in places.items() if place[2] != at[2] and tuple(place[:2]) != tuple(at[:2])}
    assert len(apart) == 16
    assert set(TASKS.proxies(target)) == apart


def test_spec_names_the_published_state_sizes() -> None:
    assert [Lift(robot).spec("source").state_size for robot in ROBOTS] == [32, 37, 32, 40]
    spec = Lift("UR5e").spec("target")
    assert (spec.name, spec.action_size, spec.control_hz) == ("target", 4, 20.0)
    assert tuple(key.name for key in spec.state_keys) == KEYS


def test_unknown_task_is_named_with_a_hint() -> None:
    with pytest.raises(UserError, match=r"no task 'x3y0h0' in R2R-Lift; .*did you mean 'x\dy0h0'"):
        block_place("x3y0h0")
    with pytest.raises(UserError, match=r"no target 'x3y0h0' in R2R-Lift; .*did you mean 'x\dy0h0'"):
        TASKS.proxies("x3y0h0")
    with pytest.raises(UserError, match="no task 'lift'"):
        Lift("Sawyer").reset(["x0y0h0", "lift"], [0, 1])


def test_bad_arguments_are_named() -> None:
    with pytest.raises(UserError, match="robot is 'Baxter'; expected one of: Sawyer, UR5e, Panda, Kinova3"):
        Lift("Baxter")  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"Lift\.joint_noise is -0\.1; expected a number, at least 0; change it"):
        Lift("Sawyer", joint_noise=-0.1)
    with pytest.raises(UserError, match=r"Lift\.horizon is 0; expected a whole number, at least 1; change it"):
        Lift("Sawyer", horizon=0)
    with pytest.raises(UserError, match=r"Lift\.threads is -1; expected a whole number, at least 0; change it"):
        Lift("Sawyer", threads=-1)


def test_pickles_before_the_first_reset() -> None:
    copy = pickle.loads(pickle.dumps(Lift("UR5e", joint_noise=0.1, horizon=50, threads=3)))
    assert (copy.robot, copy.joint_noise, copy.horizon, copy.threads) == ("UR5e", 0.1, 50, 3)


def test_import_is_light_and_the_build_leaves_no_trace(tmp_path: Path) -> None:
    script = """
        import os, sys
        os.environ.pop("MUJOCO_GL", None)
        from plp_lightning.envs.lift.simulator import Lift
        import plp_lightning.envs.experts.lift
        heavy = {"mujoco", "robosuite", "numba", "torch"} & set(sys.modules)
        assert not heavy, heavy
        Lift("Sawyer").reset(["x0y0h0"], [0])
        assert "robosuite" not in sys.modules
        assert "MUJOCO_GL" not in os.environ
        assert not {name for name in sys.modules if name.startswith("OpenGL.")}
        """
    call = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{textwrap.dedent(script)}"]
    cache = {"PLP_CACHE": str(tmp_path / "cache")}  # it is built here
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False, env=os.environ | cache)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert list(tmp_path.iterdir()) == [tmp_path / "cache"]


def robosuite_twin(lift: Lift) -> Any:
    """robosuite's environment in the state of the simulator's first episode, hand pointing down."""
    from plp_lightning.envs.lift.building import robosuite_env
    from plp_lightning.envs.lift.osc import DOWN
    from plp_lightning.envs.native import STATE

    episodes, env = lift._physics.episodes, robosuite_env(lift.robot)
    env.reset()
    put = partial(mujoco.mj_setState, env.sim.model._model, env.sim.data._data, episodes.state[0], STATE)
    put()
    env.sim.forward()
    robot = env.robots[0]
    controller = robot.part_controllers["right"]
    robot.composite_controller.update_state()
    controller.update_initial_joints(episodes.rest[0])
    controller.compute_goal_ori = lambda delta: controller.origin_ori.T @ DOWN
    put()  # forward() has moved the solver's warm start
    return env


def robosuite_state(observation: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate([observation[f"robot0_{key}"] for key in KEYS])


@pytest.mark.parametrize(("robot", "tolerance"), [("Sawyer", 1e-6), ("UR5e", 1e-4), ("Panda", 1e-6), ("Kinova3", 1e-4)])
def test_steps_equal_those_of_robosuite(robot: Robot, tolerance: float) -> None:
    lift = simulator(robot)
    first = begin(lift, EPISODES[:1])[0]
    env = robosuite_twin(lift)
    sensed: dict[str, np.ndarray] = {}  # read afresh: asking the environment would shift its sampling by a substep
    for name, observable in env._observables.items():
        sensed[name] = observable._sensor(sensed)
    np.testing.assert_allclose(first, robosuite_state(sensed), atol=1e-6)
    actions = random_actions(45, 1)
    ours, theirs = [], []
    for action in actions:
        theirs.append(robosuite_state(env.step(action[0])[0]))
        ours.append(lift.step(action, np.array([0])).observation.state[0])
    spec = lift.spec(robot)
    pose = spec.columns(["joint_pos_cos", "joint_pos_sin", "eef_pos", "eef_quat"])
    np.testing.assert_allclose(np.array(ours)[:5, pose], np.array(theirs)[:5, pose], atol=1e-6)
    np.testing.assert_allclose(np.array(ours)[:, pose], np.array(theirs)[:, pose], atol=tolerance)
    speed, fingers = spec.columns(["joint_vel"]), spec.columns(["gripper_qpos"])
    np.testing.assert_allclose(np.array(ours)[:, speed], np.array(theirs)[:, speed], atol=50 * tolerance)
    # The Robotiq's knuckles collide at rest: a change of 1e-16 rad grows to 1e-3 rad within a step.
    finger_tolerance = 1e-6 if robot in ("Sawyer", "Panda") else 0.15
    np.testing.assert_allclose(np.array(ours)[:, fingers], np.array(theirs)[:, fingers], atol=finger_tolerance)


def test_observation_after_reset_holds_the_noisy_pose() -> None:
    spec, rest = Lift("Sawyer").spec("d"), np.array([0, -1.18, 0.0, 2.18, 0.0, 0.57, -1.57])
    still = Lift("Sawyer", joint_noise=0.0, threads=1).reset(["x0y0h0"], [0]).state[0]
    np.testing.assert_allclose(still[spec.columns(["joint_pos_cos"])], np.cos(rest), atol=1e-6)
    np.testing.assert_allclose(still[spec.columns(["joint_vel"])], 0.0)
    np.testing.assert_allclose(still[spec.columns(["gripper_qpos"])], [0.020833, -0.020833], atol=1e-6)
    states = begin(simulator("Sawyer"), [("x0y0h0", seed) for seed in range(200)])
    sine, cosine = (states[:, spec.columns([f"joint_pos_{part}"])] for part in ("sin", "cos"))
    noise = np.arctan2(sine, cosine) - rest
    assert abs(noise.std() - 0.05) < 0.005
    assert abs(noise.mean()) < 0.005


def test_seed_and_task_decide_the_first_observation() -> None:
    states = begin(simulator("Sawyer"), [("x0y0h0", 1), ("x0y0h0", 2), ("x0y0h1", 1), ("x0y0h0", 1)])
    assert np.array_equal(states[0], states[3])
    assert not np.array_equal(states[0], states[1])
    assert not np.array_equal(states[0], states[2])


@pytest.mark.parametrize("robot", ROBOTS)
def test_neither_batch_nor_order_nor_threads_change_an_episode(robot: Robot) -> None:
    actions = random_actions(12, len(EPISODES))
    together = run(simulator(robot), EPISODES, actions)
    order = [4, 0, 5, 2, 1, 3]
    shuffled = run(simulator(robot, threads=3), [EPISODES[i] for i in order], actions[:, order])
    np.testing.assert_array_equal(shuffled, together[:, order])
    alone = run(simulator(robot), EPISODES[2:3], actions[:, 2:3])
    np.testing.assert_array_equal(alone[:, 0], together[:, 2])


def test_episodes_may_be_stepped_a_few_at_a_time() -> None:
    lift, actions = simulator("Sawyer", threads=3), random_actions(2, 6)
    together = run(lift, EPISODES, actions)
    begin(lift, EPISODES)
    for action, states in zip(actions, together[1:], strict=True):
        for rows in ([5, 1], [0], [], [2, 4, 3]):
            step = lift.step(action[rows], np.array(rows, dtype=int))
            np.testing.assert_array_equal(step.observation.state, states[rows])


def test_actions_are_clipped() -> None:
    lift = simulator("Sawyer")
    wide = run(lift, EPISODES[:1], np.full((3, 1, 4), 7.0))
    np.testing.assert_array_equal(wide, run(lift, EPISODES[:1], np.ones((3, 1, 4))))


@pytest.mark.parametrize("robot", ROBOTS)
def test_only_the_bad_episode_becomes_invalid(robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lift, rows = simulator(robot, threads=2), np.arange(6)
    good = run(lift, EPISODES, np.zeros((2, 6, 4)))
    first = begin(lift, EPISODES)
    engine = lift._physics
    engine.states[3, engine.qvel], engine.states[5, engine.qvel] = 5e3, np.nan
    actions = np.zeros((6, 4))
    actions[1, 0], actions[4, 3] = np.nan, -np.inf
    for expected in good[1:]:
        step = lift.step(actions, rows)
        assert step.invalid.tolist() == [False, True, False, True, True, True]
        assert not step.success[step.invalid].any()
        np.testing.assert_array_equal(step.observation.state[~step.invalid], expected[~step.invalid])
        np.testing.assert_array_equal(step.observation.state[step.invalid], first[step.invalid])
    assert list(tmp_path.iterdir()) == []


def test_sawyers_first_joint_moves() -> None:
    lift = simulator("Sawyer")
    sine = lift.spec("d").columns(["joint_pos_sin"])[0]
    states = run(lift, [("x1y1h0", 0)], np.tile([0.0, 1.0, 0.0, -1.0], (15, 1, 1)))
    assert states[-1, 0, sine] - states[0, 0, sine] > 0.1


@pytest.mark.parametrize("robot", ROBOTS)
def test_blocks_rest_where_their_tasks_say_and_are_not_yet_lifted(robot: Robot) -> None:
    lift = simulator(robot)
    lift.reset(TASKS.names, [0] * 27)
    for _ in range(3):
        step = lift.step(np.zeros((27, 4)), np.arange(27))
    heights = [block_place(task)[2] for task in TASKS.names]
    np.testing.assert_allclose(lift._physics.episodes.block_z, heights, atol=5e-4)
    assert not step.success.any()


@pytest.mark.parametrize("robot", ROBOTS)
def test_hand_keeps_pointing_down(robot: Robot) -> None:
    lift = simulator(robot)
    quaternion = lift.spec("d").columns(["eef_quat"])
    states = run(lift, [("x1y1h0", 4)], random_actions(40, 1, seed=1) * [0.7, 0.7, 0.2, 1.0])
    x, y, _, _ = states[-1, 0, quaternion]
    tilt = np.degrees(np.arccos(-(1.0 - 2.0 * (x**2 + y**2))))  # of the hand's axis from straight down
    assert tilt < 6.0
