"""What simulators show to people: their states, whoever else runs, with a maze the same for every body."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from plp_lightning.envs import Lift, LinearPoint, PointMaze, Reach, WalkerMaze
from plp_lightning.envs.rendering.backend import works
from plp_lightning.envs.synthetic import GREEN, SeenPoint

drawn = pytest.mark.skipif(not (works("egl") or works("osmesa")), reason="neither EGL nor OSMesa is installed")
SIZE = (60, 80)
MADE: dict[str, tuple[Callable[[], Any], str]] = {
    "linear": (lambda: LinearPoint(1), "goal_3"),
    "seen": (lambda: SeenPoint(1), "red"),
    "point": (lambda: PointMaze("umaze"), "s0_g_1_1"),
    "ant": (lambda: WalkerMaze("umaze"), "s0_g_1_1"),
    "spider": (lambda: WalkerMaze("medium", legs=6), "s0_g_6_6"),
    "reach": (lambda: Reach("front"), "red"),
    "lift": (lambda: Lift("UR5e"), "x2y2h2"),
}
CASES = [pytest.param(*made, id=name, marks=[] if name in ("linear", "seen") else drawn) for name, made in MADE.items()]


@pytest.mark.parametrize(("make", "task"), CASES)
def test_pictures_are_of_an_episode_s_state_alone(make: Callable[[], Any], task: str) -> None:
    alone, together = make(), make()
    actions = np.random.default_rng(0).uniform(-1, 1, (4, 1, alone.spec("").action_size)).astype(np.float32)
    alone.reset([task], [7])
    together.reset([task] * 3, [5, 6, 7])
    pictures = []
    for action in actions:
        alone.step(action, np.array([0]))
        together.step(np.concatenate([action, -action]), np.array([2, 1]))
        pictures.append(alone.render(np.array([0]), SIZE)[0])
    shown = together.render(np.array([2, 0]), SIZE)
    assert shown.shape == (2, *SIZE, 3)
    assert shown.dtype == np.uint8
    np.testing.assert_array_equal(shown[0], pictures[-1])
    assert not np.array_equal(pictures[0], pictures[-1])
    assert not np.array_equal(shown[0], shown[1])
    assert together.render(np.array([1]), (24, 24)).shape == (1, 24, 24, 3)


def green(picture: np.ndarray) -> np.ndarray:
    """Row and column of the middle of what is green, as shares of the picture."""
    red, light, blue = picture.astype(int).transpose(2, 0, 1)
    rows, columns = np.nonzero((light > red + 40) & (light > blue + 20))
    assert len(rows) > 20
    middle: np.ndarray = np.array([rows.mean(), columns.mean()]) / picture.shape[:2]
    return middle


@drawn
@pytest.mark.parametrize("task", ["s0_g_1_1", "s0_g_3_2", "s0_g_1_3"])
def test_a_goal_is_at_the_same_place_for_all_bodies_and_frames(task: str) -> None:
    mazes = [
        PointMaze("umaze"),
        PointMaze("umaze", frame="gymnasium"),
        WalkerMaze("umaze"),
        WalkerMaze("umaze", legs=6),
    ]
    mazes += [PointMaze("umaze", swap_axes=True, negate_actions=True), PointMaze("umaze", mirror=True, quarter_turns=1)]
    places = []
    for maze in mazes:
        maze.reset([task], [3])
        places.append(green(maze.render(np.array([0]), (128, 128))[0]))
    np.testing.assert_allclose(places, [places[0]] * len(places), atol=0.02)
    row, column = map(int, task.split("_")[2:])
    assert np.abs(places[0] - (np.array([row, column]) + 0.5) / 5).max() < 0.06


@drawn
def test_a_simulator_with_a_camera_shows_what_that_sees() -> None:
    reach = Reach("front_left", image_size=64)
    image = reach.reset(["red", "red"], [3, 4]).images["image"]
    np.testing.assert_array_equal(reach.render(np.arange(2), (64, 64)), image)


def test_the_point_s_own_goal_is_marked() -> None:
    simulator = LinearPoint(1)
    simulator.reset(["goal_0", "goal_2"], [1, 1])
    right, above = (green(picture) for picture in simulator.render(np.arange(2), (100, 100)))
    np.testing.assert_allclose([right, above], [[0.5, 0.885], [0.115, 0.5]], atol=0.02)
    assert (simulator.render(np.arange(1), (100, 100))[0] == GREEN).all(axis=-1).sum() > 20
