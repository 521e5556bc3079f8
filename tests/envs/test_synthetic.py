from __future__ import annotations

import pickle

import numpy as np
import pytest

from datamodules.errors import UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.synthetic import GOALS, RADIUS, STRIDE, LinearPoint, LinearPointExpert
from plp_lightning.envs.views import located

TASKS = LinearPoint(1).tasks.names


def test_goals_lie_on_the_unit_circle_counter_clockwise() -> None:
    simulator = LinearPoint(1)
    assert len(TASKS) == GOALS == 8
    np.testing.assert_allclose(simulator.goal("goal_0"), [1, 0], atol=1e-12)
    np.testing.assert_allclose(simulator.goal("goal_1"), [0.5**0.5, 0.5**0.5])
    np.testing.assert_allclose(simulator.goal("goal_2"), [0, 1], atol=1e-12)


def test_proxies_are_all_other_goals() -> None:
    simulator = LinearPoint(1)
    assert simulator.tasks.proxies("goal_3") == tuple(task for task in TASKS if task != "goal_3")
    assert simulator.tasks.of("goal_3") == ("goal_3",)
    with pytest.raises(UserError, match="no target 'goal_9' in LinearPoint; expected one of: goal_0, goal_1"):
        simulator.tasks.proxies("goal_9")


def test_the_state_is_the_point_behind_the_linear_map() -> None:
    simulator = LinearPoint(3, state_size=6)
    state = simulator.reset(["goal_0", "goal_5"], [4, 5]).state
    assert state.shape == (2, 6)
    assert state.dtype == np.float32
    plane = np.array([np.random.default_rng(seed).uniform(-0.3, 0.3, 2) for seed in (4, 5)])
    np.testing.assert_allclose(state, plane @ simulator.lift.T + simulator.shift, rtol=1e-6)
    np.testing.assert_allclose(simulator.shared_position(state), plane, atol=1e-6)
    np.testing.assert_allclose(simulator.lift.T @ simulator.lift, np.eye(2), atol=1e-12)
    assert simulator.spec("x").state_size == 6


def test_a_step_turns_the_action_back_into_the_plane() -> None:
    simulator = LinearPoint(3)
    before = simulator.shared_position(simulator.reset(["goal_0"], [1]).state)
    velocity = np.array([0.6, -0.3])
    after = simulator.shared_position(
        simulator.step((simulator.rotation @ velocity)[None], np.arange(1)).observation.state
    )
    np.testing.assert_allclose(after - before, STRIDE * velocity[None], atol=1e-6)


def test_actions_are_clipped() -> None:
    one, other = LinearPoint(3), LinearPoint(3)
    for simulator in (one, other):
        simulator.reset(["goal_0"], [1])
    large = one.step(np.array([[7.0, -0.5]]), np.arange(1)).observation.state
    np.testing.assert_array_equal(large, other.step(np.array([[1.0, -0.5]]), np.arange(1)).observation.state)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_action_that_is_no_number_is_invalid_and_no_success(bad: float) -> None:
    simulator = LinearPoint(3)
    simulator.reset(["goal_0"] * 3, [1, 2, 3])
    simulator.point[1] = simulator.goal("goal_0")
    step = simulator.step(np.array([[0.1, 0.1], [0.0, bad]]), np.array([0, 1]))
    assert step.invalid.tolist() == [False, True]
    assert step.success.tolist() == [False, False]
    assert np.isfinite(step.observation.state).all()


def test_success_is_being_near_the_goal() -> None:
    simulator = LinearPoint(3)
    simulator.reset(["goal_2", "goal_2"], [1, 2])
    simulator.point[:] = [[0, 1 - RADIUS - 0.01], [0, 1 - RADIUS + 0.01]]
    assert simulator.step(np.zeros((2, 2)), np.arange(2)).success.tolist() == [False, True]


def test_only_the_stepped_episodes_move() -> None:
    simulator = LinearPoint(3)
    simulator.reset(["goal_0"] * 3, [1, 2, 3])
    before = simulator.point.copy()
    step = simulator.step(np.ones((2, 2)), np.array([2, 0]))
    assert (simulator.point != before).any(axis=1).tolist() == [True, False, True]
    np.testing.assert_allclose(simulator.shared_position(step.observation.state), simulator.point[[2, 0]], atol=1e-6)


def test_the_same_seed_gives_the_same_first_observation() -> None:
    one, again = (LinearPoint(3).reset(["goal_0", "goal_1"], [5, 6]).state for _ in range(2))
    np.testing.assert_array_equal(one, again)
    alone = LinearPoint(3).reset(["goal_1"], [6]).state
    np.testing.assert_array_equal(alone[0], one[1])
    assert not np.allclose(LinearPoint(4).reset(["goal_0"], [5]).state, one[:1])


def test_the_expert_drives_straight_to_the_goal() -> None:
    simulator, expert = LinearPoint(3), LinearPointExpert(gain=2.0)
    state = simulator.reset(["goal_0", "goal_4"], [1, 2]).state
    simulator.point[1] = [-0.8, 0.0]  # 0.2 from its goal: the speed is 2.0 · 0.2
    state = simulator._observe(np.arange(2)).state
    expert.begin(simulator, ["goal_0", "goal_4"], [1, 2])
    actions = expert.act(Observation(state), np.arange(2))
    velocity = actions @ simulator.rotation
    towards = simulator.goal("goal_0") - simulator.point[0]
    np.testing.assert_allclose(velocity[0], towards / np.linalg.norm(towards), atol=1e-5)
    np.testing.assert_allclose(velocity[1], [-0.4, 0.0], atol=1e-5)
    assert np.abs(actions).max() <= 1


def test_the_expert_knows_one_simulator_only() -> None:
    class Other(LinearPoint):
        pass

    LinearPointExpert().begin(Other(1), ["goal_0"], [0])
    with pytest.raises(UserError, match="LinearPointExpert demonstrates in LinearPoint only, not in Simulator"):
        LinearPointExpert().begin(object.__new__(_plain()), ["goal_0"], [0])


def _plain() -> type[Simulator]:
    return type("Simulator", (Simulator,), dict.fromkeys(Simulator.__abstractmethods__))


def test_a_simulator_has_to_meet_four_members() -> None:
    assert Simulator.__abstractmethods__ == {"tasks", "spec", "reset", "step"}


def test_a_simulator_without_a_shared_position_says_so() -> None:
    with pytest.raises(UserError, match=r"Simulator knows no position that domains share; .* choose another --score"):
        located(object.__new__(_plain()))
    assert located(LinearPoint(1)) is not None


def test_a_simulator_can_be_sent_to_another_process() -> None:
    simulator = pickle.loads(pickle.dumps(LinearPoint(3, state_size=5, horizon=7)))
    np.testing.assert_array_equal(
        simulator.reset(["goal_0"], [1]).state, LinearPoint(3, 5).reset(["goal_0"], [1]).state
    )
    assert simulator.horizon == 7
