"""Planar arms: joints that follow their speeds, tips that come to places, and episodes that depend on nothing else."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from datamodules.errors import ConfigError
from datamodules.settings import Configured
from plp_lightning.envs import LinearPoint, PlanarArm
from plp_lightning.envs.experts import PlanarArmExpert
from plp_lightning.envs.planar import FOLDED, JITTER, PLACES, RADIUS
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.views import Located, Rendered

ARMS = {"two": [0.5, 0.5], "three": [0.4, 0.35, 0.25], "five": [0.2, 0.3, 0.2, 0.1, 0.2]}
TASKS = [*PLACES] * 3


def acted(names: list[str], seeds: list[int], actions: np.ndarray) -> np.ndarray:
    """All states ``(T + 1, E, O)`` of a three-link arm under actions ``(T, E, 3)``."""
    arm, rows = PlanarArm(ARMS["three"]), np.arange(len(names))
    return np.array([arm.reset(names, seeds).state, *(arm.step(action, rows).observation.state for action in actions)])


def test_the_tip_is_where_the_links_end() -> None:
    arm = PlanarArm(ARMS["three"])
    state = arm.reset(["x0y0"], [3]).state[0]
    first, second, third = np.cumsum(state[:3])
    for axis, function in enumerate((math.cos, math.sin)):
        tip = 0.4 * function(first) + 0.35 * function(second) + 0.25 * function(third)
        assert state[3 + axis] == pytest.approx(tip, abs=1e-6)
    np.testing.assert_array_equal(arm.shared_position(state[None]), state[None, 3:])


def test_joints_turn_by_their_speeds_and_no_further_than_half_a_turn() -> None:
    states = acted(["x0y0"], [0], np.tile(np.array([0.5, -9.0, 1.0]), (60, 1, 1)))
    np.testing.assert_allclose(states[1, 0, :3] - states[0, 0, :3], [0.5 * 0.075, -0.075, 0.075], atol=1e-6)
    np.testing.assert_allclose(states[-1, 0, 1:3], [-np.pi, np.pi], atol=1e-6)


def test_episodes_begin_folded_and_differ_by_seed() -> None:
    states = PlanarArm(ARMS["five"]).reset(["x0y0"] * 50, range(50)).state[:, :5]
    away = states - np.array([FOLDED[0], *[FOLDED[1] / 4] * 4])
    assert 0.2 < np.abs(away).max() <= JITTER + 1e-6
    assert len({*states[:, 0].tolist()}) == 50


def test_an_episode_is_the_same_alone_and_in_company() -> None:
    actions = np.random.default_rng(0).normal(size=(9, 3, 3))
    together = acted(["x0y2", "x1y1", "x0y2"], [7, 8, 9], actions)
    for i, (task, seed) in enumerate((("x0y2", 7), ("x1y1", 8), ("x0y2", 9))):
        np.testing.assert_array_equal(together[:, i], acted([task], [seed], actions[:, i : i + 1])[:, 0])


def test_an_action_that_is_no_number_is_invalid_and_moves_nothing() -> None:
    arm = PlanarArm(ARMS["two"])
    first = arm.reset(["x0y0"] * 2, [0, 1]).state
    step = arm.step(np.array([[np.nan, 0], [np.inf, 1]]), np.arange(2))
    assert step.invalid.all()
    assert not step.success.any()
    np.testing.assert_array_equal(step.observation.state[0], first[0])


@pytest.mark.parametrize("links", ARMS.values(), ids=ARMS)
def test_the_expert_brings_any_arm_to_all_places(links: list[float]) -> None:
    arm, expert = PlanarArm(links), PlanarArmExpert()
    expert.begin(arm, TASKS, range(len(TASKS)))
    found = rollout(arm, expert.act, TASKS, range(len(TASKS)))
    assert found.success.all()
    tips = arm.shared_position(arm.reset(TASKS, range(len(TASKS))).state)
    ways = np.linalg.norm(np.array([PLACES[task] for task in TASKS]) - tips, axis=1)
    assert (found.steps >= (ways - RADIUS) / 0.5 * 20 - 1).all(), "faster than it may be"


def test_it_is_what_pictures_scores_and_processes_ask_for() -> None:
    arm = pickle.loads(pickle.dumps(PlanarArm(ARMS["two"])))
    assert isinstance(arm, Located)
    assert isinstance(arm, Rendered)
    assert isinstance(arm, Configured)
    spec = arm.spec("arm")
    assert [(key.name, key.shape, key.unit) for key in spec.observation] == [
        ("joints", (2,), "rad"),
        ("tip", (2,), "m"),
    ]
    assert spec.action_limits == ((-1.5, -1.5), (1.5, 1.5))
    assert spec.env != PlanarArm(ARMS["three"]).spec("arm").env


def test_a_picture_shows_the_arm_and_the_episodes_place() -> None:
    arm = PlanarArm(ARMS["two"])
    arm.reset(["x0y0", "x2y2"], [0, 0])
    pictures = arm.render(np.arange(2), (60, 80))
    assert pictures.shape == (2, 60, 80, 3)
    green = (pictures == (0, 158, 115)).all(axis=3)
    low, high = (np.median(np.nonzero(places), axis=1) for places in green)
    assert low[0] > high[0]
    assert low[1] < high[1]
    assert (pictures[0] == (0, 114, 178)).all(axis=2).sum() > 40
    np.testing.assert_array_equal(pictures[1], arm.render(np.array([1]), (60, 80))[0])


@pytest.mark.parametrize("links", [[1.0], [0.3, 0.3], [0.9, 0.2], []])
def test_links_that_reach_too_little_are_told(links: list[float]) -> None:
    with pytest.raises(ConfigError, match=r"PlanarArm.links is \[.*\]; expected two or more .* from 0.30 to 0.83 m"):
        PlanarArm(links)


def test_the_expert_refuses_other_simulators() -> None:
    with pytest.raises(ConfigError, match="PlanarArmExpert got simulator LinearPoint; expected PlanarArm"):
        PlanarArmExpert().begin(LinearPoint(1), ["goal_0"], [0])
