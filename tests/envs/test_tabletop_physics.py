"""V2V's physics against Meta-World's own environments, and what a demonstrator that does not look can do."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from datamodules.types import Observation
from plp_lightning.envs.experts.tabletop import ReachExpert, WindowExpert, push, reach
from plp_lightning.envs.native import STATE
from plp_lightning.envs.rendering import backend
from plp_lightning.envs.rollout import Episodes, rollout
from plp_lightning.envs.tabletop import physics
from plp_lightning.envs.tabletop.simulator import AREAS, SLOTS, WINDOW_AREA, Reach, Tabletop, Window


class NoCamera:
    """Draws nothing, so that these tests need no OpenGL."""

    def __init__(self, *_: object) -> None: ...

    def image(self, data: object, out: np.ndarray) -> np.ndarray:
        return out


@pytest.fixture(autouse=True)
def _no_images(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "choose_backend", lambda: "egl")
    monkeypatch.setattr(physics, "Camera", NoCamera)


def metaworld_env(simulator: Tabletop, task: str, row: int) -> Any:
    """Meta-World's environment at the start of episode ``row`` of a simulator that was just reset."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from metaworld.envs.sawyer_reach_v3 import SawyerReachEnvV3
        from metaworld.envs.sawyer_window_close_v3 import SawyerWindowCloseEnvV3
        from metaworld.envs.sawyer_window_open_v3 import SawyerWindowOpenEnvV3
    scene = simulator._physics.scene
    state = start_of(simulator, row)
    if isinstance(simulator, Reach):
        env = SawyerReachEnvV3()
        furniture = [*state.qpos[scene.object_qpos], *simulator.aims(np.array([row]))[0]]
    else:
        env = SawyerWindowOpenEnvV3() if task == "open" else SawyerWindowCloseEnvV3()
        furniture = state.mocap_pos[scene.furniture[0]]
    env.hand_init_pos, env._last_rand_vec = state.mocap_pos[scene.follower].copy(), np.array(furniture)
    env._set_task_called = True
    env.reset()
    if not isinstance(simulator, Reach):
        mujoco.mj_forward(env.model, env.data)  # its reset leaves the window where it was
        env._prev_obs = env._get_curr_obs_combined_no_goal()
    return env


def start_of(simulator: Tabletop, row: int) -> mujoco.MjData:
    model = simulator._physics.scene.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, simulator._physics.states[row], STATE)
    return data


@pytest.mark.parametrize(
    ("simulator", "task"),
    [(Reach("front_left", threads=2), "green"), (Window("rear", threads=2), "open"), (Window("rear"), "close_x1y0")],
    ids=["reach", "open", "close"],
)
def test_equals_metaworld_step_by_step(simulator: Tabletop, task: str) -> None:
    observation = simulator.reset([task] * 3, [4, 5, 6])
    expert = ReachExpert() if isinstance(simulator, Reach) else WindowExpert()
    expert.begin(simulator, [task] * 3, [4, 5, 6])
    env, noise, solved = metaworld_env(simulator, task, 1), np.random.default_rng(0), []
    rows = np.array([2, 1, 0])
    for _ in range(110):
        ours = start_of(simulator, 1)
        np.testing.assert_array_equal(ours.qpos, env.data.qpos)
        np.testing.assert_array_equal(ours.qvel, env.data.qvel)
        actions = expert.act(observation.take(rows), rows).astype(float) + noise.normal(0, 0.3, (3, 4))
        step = simulator.step(actions, rows)
        theirs, _, _, _, info = env.step(np.clip(actions[1], -1, 1))
        np.testing.assert_array_equal(
            step.observation.state[1], theirs[[0, 1, 2, 3, 18, 19, 20, 21]].astype(np.float32)
        )
        assert step.success[1] == info["success"]
        solved.append(step.success[1])
        observation = step.observation.take(rows)  # rows is its own inverse
    assert any(solved)
    assert not all(solved)


def run(simulator: Tabletop, act: Callable[[np.ndarray, np.ndarray], np.ndarray], tasks: list[str]) -> Episodes:
    """Outcome of a policy of ``hand (n, 3)`` and ``episodes (n,)``."""

    def on_state(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return act(observation.state[:, :3], episodes)

    return rollout(simulator, on_state, tasks, range(len(tasks)))


def test_a_blind_reach_is_a_guess() -> None:
    simulator = Reach("front_left")
    tasks = list(simulator.tasks.names) * 8
    for slot in SLOTS[:2]:
        episodes = run(simulator, lambda hand, _, slot=slot: reach(hand, np.tile(slot, (len(hand), 1))), tasks)  # type: ignore[misc]
        at_slot = (simulator.aims(np.arange(len(tasks))) == slot).all(axis=1)
        np.testing.assert_array_equal(episodes.success, at_slot)
        assert 0.1 < episodes.success.mean() < 0.6


def test_visiting_the_balls_in_turn_does_not_help() -> None:
    simulator = Reach("front_right")
    tasks, clock = list(simulator.tasks.names) * 4, np.zeros(12, dtype=int)

    def sweep(hand: np.ndarray, episodes: np.ndarray) -> np.ndarray:
        clock[episodes] += 1
        return reach(hand, SLOTS[np.minimum(clock[episodes] // 45, 2)])

    episodes = run(simulator, sweep, tasks)
    at_first = (simulator.aims(np.arange(12)) == SLOTS[0]).all(axis=1)
    np.testing.assert_array_equal(episodes.success, at_first)


@pytest.mark.parametrize(("task", "least", "most"), [("close_x1y0", 0.1, 0.6), ("open", 0.0, 0.35)])
def test_a_blind_push_at_the_middle_of_the_area_mostly_fails(task: str, least: float, most: float) -> None:
    simulator, count = Window("rear"), 24
    share = (np.array(AREAS[task]) + 0.5) / 2 if task in AREAS else 0.5
    middle = WINDOW_AREA[0] + share * (WINDOW_AREA[1] - WINDOW_AREA[0])
    simulator.reset([task] * count, range(count))
    offset = np.zeros((count, 3))
    offset[:, :2] = [start_of(simulator, i).mocap_pos[1, :2] - middle for i in range(count)]

    def blind(hand: np.ndarray, episodes: np.ndarray) -> np.ndarray:
        # It knows how far the window is open, more than a policy that does not see it.
        return push(hand, simulator.aims(episodes) - offset[episodes], np.full(len(hand), task == "open"))

    assert least <= run(simulator, blind, [task] * count).success.mean() <= most
