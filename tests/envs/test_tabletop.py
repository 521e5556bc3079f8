"""The promises of a simulator, for V2V: purity, validity, quiet imports, pictures that give nothing away."""

from __future__ import annotations

import gc
import pickle
import subprocess
import sys
import textwrap
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from datamodules.errors import UserError
from plp_lightning.envs.rendering import backend
from plp_lightning.envs.tabletop.simulator import (
    AREAS,
    REACH_HAND,
    SLOTS,
    WINDOW_AREA,
    WINDOW_HAND,
    Reach,
    Tabletop,
    Window,
)
from plp_lightning.envs.views import Arranged

ROOT = Path(__file__).parents[2]
EPISODES = [("red", 3), ("blue", 3), ("green", 8), ("red", 0), ("blue", 5)]

drawn = pytest.mark.skipif(
    not (backend.works("egl") or backend.works("osmesa")), reason="neither EGL nor OSMesa is installed"
)


@cache
def reach(threads: int = 1) -> Reach:
    """A simulator that the tests share, since each reset begins anew."""
    return Reach("front_left", image_size=32, threads=threads)


@cache
def window() -> Window:
    return Window("rear", image_size=32)


def run(simulator: Tabletop, episodes: list[tuple[str, int]], actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States ``(T + 1, E, 8)`` and images ``(T + 1, E, H, W, 3)`` under ``actions (T, E, 4)``."""
    rows = np.arange(len(episodes))
    seen = [simulator.reset([task for task, _ in episodes], [seed for _, seed in episodes])]
    seen += [simulator.step(action, rows).observation for action in actions]
    return np.stack([o.state for o in seen]), np.stack([o.images["image"] for o in seen])


def random_actions(steps: int, episodes: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.2, 1.2, (steps, episodes, 4))


def test_tasks_and_proxies() -> None:
    assert Reach("front").tasks.names == ("red", "green", "blue")
    assert Reach("front").tasks.proxies("green") == ("red", "blue")
    assert Window("front").tasks.proxies("open") == ("close_x0y0", "close_x0y1", "close_x1y0", "close_x1y1")
    assert Window("front").tasks.of("open") == ("open",)


def test_spec_describes_what_is_observed() -> None:
    spec = Window("rear", image_size=48).spec("robot_side")
    assert (spec.name, spec.state_size, spec.action_size, spec.control_hz) == ("robot_side", 8, 4, 80.0)
    assert spec.image_keys[0].shape == (48, 48, 3)
    assert tuple(key.name for key in spec.state_keys) == ("hand_pos", "gripper", "last_hand_pos", "last_gripper")
    state = np.arange(16.0).reshape(2, 8)
    np.testing.assert_array_equal(Reach("front").shared_position(state), [[0, 1, 2], [8, 9, 10]])


def test_bad_arguments_are_named() -> None:
    with pytest.raises(UserError, match="view is 'left'; expected one of: front_left, front_right, front, rear"):
        Reach("left")  # type: ignore[arg-type]
    with pytest.raises(UserError, match="image_size is 4; expected 8 to 512 pixels"):
        Window("rear", image_size=4)
    with pytest.raises(UserError, match=r"Reach\.horizon is 0; expected a whole number, at least 1; change it"):
        Reach("rear", horizon=0)
    with pytest.raises(UserError, match=r"Window\.threads is -1; expected a whole number, at least 0; change it"):
        Window("rear", threads=-1)


def test_unknown_task_is_named_with_a_hint() -> None:
    with pytest.raises(UserError, match=r"no task 'close_x2y0' in V2V-Open; .*, open; did you mean 'close_x\dy0'"):
        Window("rear").reset(["open", "close_x2y0"], [0, 1])
    with pytest.raises(UserError, match="no target 'yellow' in V2V-Reach; expected one of: red, green, blue"):
        Reach("rear").tasks.proxies("yellow")


def test_pickles_before_the_first_reset() -> None:
    copy = pickle.loads(pickle.dumps(Window("front", image_size=32, horizon=70, threads=3)))
    assert (copy.view, copy.image_size, copy.horizon, copy.threads) == ("front", 32, 70, 3)


@drawn
def test_import_is_light_and_the_end_is_silent(tmp_path: Path) -> None:
    script = """
        import sys
        from plp_lightning.envs.tabletop.simulator import Reach
        import plp_lightning.envs.experts.tabletop
        heavy = {"mujoco", "OpenGL", "metaworld", "gymnasium", "torch"} & set(sys.modules)
        assert not heavy, heavy
        for view in ("front_left", "front_right"):
            Reach(view, threads=2).reset(["red", "blue"], [0, 1])
        kept = Reach("front", threads=2)
        kept.reset(["red", "blue"], [0, 1])
        assert "metaworld" not in sys.modules
        """
    call = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{textwrap.dedent(script)}"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@drawn
def test_neither_state_nor_image_depends_on_the_colour_that_is_asked_for() -> None:
    seeds, tasks = [7, 7, 7, 8, 8, 8], [*Reach("front").tasks.names] * 2
    states, images = run(reach(), list(zip(tasks, seeds, strict=True)), np.zeros((3, 6, 4)))
    for other in (1, 2):
        np.testing.assert_array_equal(states[:, [0, 3]], states[:, [other, 3 + other]])
        np.testing.assert_array_equal(images[:, [0, 3]], images[:, [other, 3 + other]])
    assert not np.array_equal(images[:, 0], images[:, 3])


@drawn
def test_nothing_is_drawn_that_marks_the_goal() -> None:
    reach().reset(["red"], [0])
    window().reset(["open"], [0])
    for simulator in (reach(), window()):
        model = simulator._physics.scene.model
        assert (model.site_group > 2).all()  # a scene shows groups 0 to 2
        assert model.ntendon == 0


@drawn
def test_all_orders_of_the_balls_come_up_and_hands_fill_their_room() -> None:
    simulator, count = reach(), 60
    states = simulator.reset(["red"] * count, range(count)).state
    orders = {tuple(np.abs(SLOTS[:, None] - balls).sum(axis=2).argmin(axis=1)) for balls in simulator._balls}
    assert len(orders) == 6
    assert (simulator.aims(np.arange(count)) == simulator._balls[:, 0]).all()
    assert (states[:, :3] > REACH_HAND[0] - 0.01).all()
    assert (states[:, :3] < REACH_HAND[1] + 0.01).all()
    assert (np.ptp(states[:, :3], axis=0) > 0.8 * (REACH_HAND[1] - REACH_HAND[0])).all()


@drawn
def test_arrangement_names_the_balls_from_one_side_to_the_other() -> None:
    reach, seeds = Reach("front_left"), list(range(8))
    for task in reach.tasks.names:
        reach.reset([task] * len(seeds), seeds)
        side = reach.aims(np.arange(len(seeds)))[:, 0]
        place = [reach.arrangement("red", seed).split().index(task) for seed in seeds]
        np.testing.assert_allclose(side, np.array([-0.15, 0.0, 0.15])[place])
    assert not isinstance(Window("rear"), Arranged)


@drawn
def test_windows_stand_in_their_areas() -> None:
    simulator, count = window(), 12
    tasks = [task for task in simulator.tasks.names for _ in range(count)]
    states = simulator.reset(tasks, list(range(count)) * 5).state
    handles = simulator.aims(np.arange(len(tasks))).reshape(5, count, 3)
    # The handle is 21 cm right of the middle of a window to be closed, and 4 cm left of one to be opened.
    places = handles[..., :2] + np.array([[-0.21, 0.095]] * 4 + [[0.04, 0.095]])[:, None]
    cell = (WINDOW_AREA[1] - WINDOW_AREA[0]) / 2
    for name, place in zip(simulator.tasks.names[:4], places[:4], strict=True):
        corner = WINDOW_AREA[0] + np.array(AREAS[name]) * cell
        assert (place >= corner - 1e-3).all()
        assert (place <= corner + cell + 1e-3).all()
    assert (np.ptp(places[4], axis=0) > 1.3 * cell).all()
    assert (states[:, :3] > WINDOW_HAND[0] - 0.02).all()
    assert (states[:, :3] < WINDOW_HAND[1] + 0.02).all()
    assert abs(np.corrcoef(states[48:, 0], places[4, :, 0])[0, 1]) < 0.8


@drawn
def test_views_see_other_episodes_for_the_same_seed() -> None:
    left, right = (Reach(view, image_size=32).reset(["red"], [0]).state for view in ("front_left", "front_right"))  # type: ignore[arg-type]
    assert not np.array_equal(left, right)


@drawn
def test_state_holds_this_step_and_the_last() -> None:
    states, images = run(reach(), EPISODES, random_actions(4, 5))
    np.testing.assert_array_equal(states[0, :, 4:], states[0, :, :4])
    np.testing.assert_array_equal(states[1:, :, 4:], states[:-1, :, :4])
    assert (states.dtype, images.dtype, images.shape) == (np.float32, np.uint8, (5, 5, 32, 32, 3))


@drawn
def test_neither_batch_nor_order_nor_threads_change_an_episode() -> None:
    actions = random_actions(12, len(EPISODES))
    together = run(reach(), EPISODES, actions)
    order = [4, 0, 2, 1, 3]
    shuffled = run(reach(threads=3), [EPISODES[i] for i in order], actions[:, order])
    alone = run(reach(), EPISODES[2:3], actions[:, 2:3])
    for all_, some, one in zip(together, shuffled, alone, strict=True):
        np.testing.assert_array_equal(some, all_[:, order])
        np.testing.assert_array_equal(one[:, 0], all_[:, 2])


@drawn
def test_episodes_may_be_stepped_a_few_at_a_time() -> None:
    actions = random_actions(2, 5)
    states, images = run(reach(3), EPISODES, actions)
    reach(3).reset([task for task, _ in EPISODES], [seed for _, seed in EPISODES])
    for action, state, image in zip(actions, states[1:], images[1:], strict=True):
        for rows in ([4, 1], [0], [], [2, 3]):
            step = reach(3).step(action[rows], np.array(rows, dtype=int))
            np.testing.assert_array_equal(step.observation.state, state[rows])
            np.testing.assert_array_equal(step.observation.images["image"], image[rows])


@drawn
def test_actions_are_clipped() -> None:
    wide, _ = run(reach(), EPISODES[:1], np.full((3, 1, 4), 7.0))
    np.testing.assert_array_equal(wide, run(reach(), EPISODES[:1], np.ones((3, 1, 4)))[0])


@drawn
def test_only_the_bad_episode_becomes_invalid() -> None:
    simulator, rows = reach(2), np.arange(5)
    good, pictures = run(simulator, EPISODES, np.zeros((2, 5, 4)))
    simulator.reset([task for task, _ in EPISODES], [seed for _, seed in EPISODES])
    engine = simulator._physics
    engine.states[3, engine.qvel.start] = np.nan
    actions = np.zeros((5, 4))
    actions[1, 3] = np.inf
    for state, image in zip(good[1:], pictures[1:], strict=True):
        step = simulator.step(actions, rows)
        assert step.invalid.tolist() == [False, True, False, True, False]
        np.testing.assert_array_equal(step.observation.state[[0, 2, 4]], state[[0, 2, 4]])
        np.testing.assert_array_equal(step.observation.images["image"][[0, 2, 4]], image[[0, 2, 4]])
        np.testing.assert_array_equal(step.observation.state[[1, 3]], good[0, [1, 3]])
        np.testing.assert_array_equal(step.observation.images["image"][[1, 3]], pictures[0, [1, 3]])


@drawn
def test_letting_a_simulator_go_leaves_other_pictures_alone() -> None:
    first = Reach("rear", image_size=32, threads=2)
    before = first.reset(["red", "green"], [0, 1]).images["image"]
    assert before is not None
    second = Reach("rear", image_size=32, threads=2)
    np.testing.assert_array_equal(second.reset(["red", "green"], [0, 1]).images["image"], before)
    threads = list(second._physics._pool._threads)
    del second
    gc.collect()
    for thread in threads:
        thread.join(timeout=60)
        assert not thread.is_alive()
    np.testing.assert_array_equal(first.reset(["red", "green"], [0, 1]).images["image"], before)
