"""Point agents that see the maze through a frame of their own are the plain agent behind a known map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datamodules.errors import ConfigError
from plp_lightning.envs.experts.waypoint import WaypointExpert
from plp_lightning.envs.maze.simulator import PointMaze

AGENTS = {
    "paper": lambda: PointMaze("umaze", swap_axes=True, negate_actions=True),
    "mirrored": lambda: PointMaze("umaze", mirror=True),
    "turned": lambda: PointMaze("umaze", quarter_turns=1),
    "turned_back": lambda: PointMaze("umaze", quarter_turns=-1),
    "half_size": lambda: PointMaze("umaze", metre=0.5),
    "everything": lambda: PointMaze(
        "umaze", swap_axes=True, negate_actions=True, mirror=True, quarter_turns=3, metre=2.0
    ),
}
BY_HAND = {
    "paper": ([2, 1, 4, 3], [-0.5, 0.25]),
    "mirrored": ([1, -2, 3, -4], [0.5, 0.25]),
    "turned": ([-2, 1, -4, 3], [0.25, 0.5]),
    "turned_back": ([2, -1, 4, -3], [-0.25, -0.5]),
    "half_size": ([0.5, 1, 1.5, 2], [0.5, -0.25]),
    # (1, 2): swapped (2, 1), mirrored (2, -1), turned back (-1, -2), doubled (-2, -4).
    "everything": ([-2, -4, -6, -8], [-0.25, 0.5]),
}
TASKS, SEEDS = ["s0_g_3_1", "s1_g_1_1", "s2_g_2_3"], [4, 5, 6]


@pytest.mark.parametrize("name", AGENTS)
def test_maps_by_hand(name: str) -> None:
    agent, (state, action) = AGENTS[name](), BY_HAND[name]
    np.testing.assert_array_equal(agent.states_of_domain(np.array([[1.0, 2.0, 3.0, 4.0]])), [state])
    np.testing.assert_array_equal(agent.actions_of_domain(np.array([[0.5, -0.25]])), [action])


@given(
    swap_axes=st.booleans(),
    negate_actions=st.booleans(),
    mirror=st.booleans(),
    quarter_turns=st.integers(-5, 5),
    metre=st.sampled_from([0.25, 1.0, 2.0]),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_every_map_is_undone_to_the_last_bit(
    swap_axes: bool, negate_actions: bool, mirror: bool, quarter_turns: int, metre: float, dtype: type
) -> None:
    agent = PointMaze(
        "umaze",
        swap_axes=swap_axes,
        negate_actions=negate_actions,
        mirror=mirror,
        quarter_turns=quarter_turns,
        metre=metre,
    )
    rng = np.random.default_rng(0)
    states, actions = rng.normal(size=(5, 4)).astype(dtype), rng.uniform(-1, 1, (5, 2)).astype(dtype)
    shown, taken = agent.states_of_domain(states), agent.actions_of_domain(actions)
    assert (shown.dtype, taken.dtype) == (dtype, dtype)
    np.testing.assert_array_equal(agent.states_in_maze(shown), states)
    np.testing.assert_array_equal(agent.actions_in_maze(taken), actions)
    assert np.abs(taken).max() <= 1


@pytest.mark.parametrize("name", AGENTS)
def test_agent_is_the_plain_one_behind_its_map(name: str) -> None:
    plain, agent, everyone = PointMaze("umaze"), AGENTS[name](), np.arange(len(TASKS))
    seen, shown = plain.reset(TASKS, SEEDS).state, agent.reset(TASKS, SEEDS).state
    rng = np.random.default_rng(0)
    for _ in range(20):
        np.testing.assert_array_equal(shown, agent.states_of_domain(seen))
        np.testing.assert_array_equal(agent.shared_position(shown), plain.shared_position(seen))
        forces = rng.uniform(-1, 1, (len(TASKS), 2))
        seen = plain.step(forces, everyone).observation.state
        shown = agent.step(agent.actions_of_domain(forces), everyone).observation.state


@pytest.mark.parametrize("name", AGENTS)
def test_expert_does_through_the_map_what_it_does_without(name: str) -> None:
    plain, agent, everyone = PointMaze("umaze"), AGENTS[name](), np.arange(len(TASKS))
    experts = {maze: WaypointExpert() for maze in (plain, agent)}
    seen = {maze: maze.reset(TASKS, SEEDS) for maze in experts}
    solved = {maze: np.zeros(len(TASKS), dtype=bool) for maze in experts}
    for maze, expert in experts.items():
        expert.begin(maze, TASKS, SEEDS)
    for _ in range(plain.horizon):
        forces = {maze: expert.act(seen[maze], everyone) for maze, expert in experts.items()}
        np.testing.assert_array_equal(forces[agent], agent.actions_of_domain(forces[plain]))
        steps = {maze: maze.step(forces[maze], everyone) for maze in experts}
        seen = {maze: step.observation for maze, step in steps.items()}
        solved = {maze: solved[maze] | step.success for maze, step in steps.items()}
    assert solved[agent].all()
    assert solved[plain].all()


@pytest.mark.parametrize("name", ["mirrored", "turned", "turned_back", "half_size"])
def test_a_force_pushes_to_where_it_points_in_the_agents_own_frame(name: str) -> None:
    agent = AGENTS[name]()
    agent.reset(["s0_g_3_1"], [4])
    force = np.array([[0.3, 0.7]])
    velocity = agent.step(force, np.array([0])).observation.state[0, 2:]
    np.testing.assert_allclose(velocity / np.linalg.norm(velocity), force[0] / np.linalg.norm(force), atol=1e-5)


def test_files_of_plain_agents_stay_as_they_are_and_others_tell_their_frame() -> None:
    said = {name: agent().spec("point").env for name, agent in AGENTS.items()}
    assert said["paper"] == "MuJoCo point in maze umaze, frame d4rl, swap_axes True, negate_actions True"
    assert said["turned"].endswith("negate_actions False, mirror False, quarter_turns 1, metre 1.0")
    assert len({*said.values()}) == len(said)


@pytest.mark.parametrize("metre", [0.0, -1.0, float("nan"), float("inf")])
def test_a_metre_has_a_length(metre: float) -> None:
    with pytest.raises(ConfigError, match=rf"PointMaze\.metre is {metre}; expected a number above 0; change it"):
        PointMaze("umaze", metre=metre)
