"""robosuite by name against the library's own loop, and the promises of a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from datamodules.types import Observation
from plp_lightning.envs import Robosuite
from plp_lightning.envs.suites.drives import drives
from plp_lightning.envs.suites.robosuite_world import RobosuiteWorld
from plp_lightning.envs.suites.setup import Setup
from plp_lightning.envs.suites.variant import Variant

TASKS = ["Stack", "Stack_x0y1"]
EPISODES = [("Stack", 3), ("Stack_x0y1", 3), ("Stack", 8)]
STATE = ["robot0_eef_pos", "robot0_gripper_qpos", "object"]
WORLDS = [
    ("Stack", "Panda", None, True),
    ("Door", "Panda", "JOINT_POSITION", True),
    ("Lift", "Sawyer", "JOINT_TORQUE", False),
    ("PickPlaceCan", "Panda", "OSC_POSITION", True),  # shows where the can is from the hand, and one of four objects
]


@cache
def world(task: str, robot: str, controller: str | None) -> RobosuiteWorld:
    """One that tests share, since each episode begins anew."""
    made = RobosuiteWorld(Setup((robot,), controller, 20, 0.02, ()), task)
    made.keys = [name for name in made.sensed() if name != "object"]
    return made


@cache
def simulator() -> Robosuite:
    """One that tests share, since each reset begins anew."""
    return Robosuite(TASKS, "Panda", state=STATE, cameras=["agentview"], image_size=16, threads=1)


def run(episodes: Sequence[tuple[str, int]], actions: np.ndarray) -> list[Observation[np.ndarray]]:
    """All that is seen under ``actions`` ``(T, E, 7)``."""
    stack, rows = simulator(), np.arange(len(episodes))
    first = stack.reset([task for task, _ in episodes], [seed for _, seed in episodes])
    return [first, *(stack.step(action, rows).observation for action in actions)]


@pytest.mark.parametrize(("task", "robot", "controller", "compiled"), WORLDS)
def test_steps_are_the_librarys_though_episodes_are_swapped(
    task: str, robot: str, controller: str | None, compiled: bool
) -> None:
    ours = world(task, robot, controller)
    actions = np.random.default_rng(1).uniform(-1, 1, (12, ours.env.action_dim))
    ours.clear()
    ours.begin(Variant.of(task, 2), np.random.default_rng(5))
    first = ours.env._get_observations()
    np.testing.assert_array_equal(ours.observe(), np.concatenate([np.ravel(first[key]) for key in ours.keys]))
    np.testing.assert_array_equal(ours.sensed()["object"].size, first["object-state"].size)
    begun, theirs = ours.take(), []
    for action in actions:
        seen = ours.env.step(action)[0]
        theirs.append((np.concatenate([np.ravel(seen[key]) for key in ours.keys]), bool(ours.env._check_success())))
    episode = begun
    for action, (state, solved) in zip(actions, theirs, strict=True):
        ours.clear()
        ours.put(episode)
        ours.act(action)
        moved = [key != "robot0_joint_acc" for key in ours.keys for _ in range(np.size(ours.sensed()[key]))]
        np.testing.assert_allclose(ours.observe()[moved], state[moved], atol=2e-5)
        assert ours.solved() == solved
        episode = ours.take()
    assert (drives(ours.env) is not None) == compiled


def test_an_episode_is_the_same_alone_in_company_and_in_used_environments() -> None:
    moves = np.random.default_rng(0).uniform(-1.2, 1.2, (3, len(EPISODES), 7)).astype(np.float32)
    together = run(EPISODES, moves)
    for i, episode in enumerate(EPISODES):
        alone = run([episode], moves[:, i : i + 1])
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one.state[0], all_of_them.state[i])
            np.testing.assert_array_equal(one.images["agentview"][0], all_of_them.images["agentview"][i])
    assert (together[0].images["agentview"][0] != together[0].images["agentview"][2]).any()
    assert simulator().render(np.array([0]), (24, 32)).shape == (1, 24, 32, 3)


def test_objects_are_placed_in_their_region_and_shown_by_one_name() -> None:
    first = run([("Stack_x0y1", seed) for seed in range(4)], np.zeros((0, 4, 7), np.float32))[0].state
    assert first.shape == (4, 3 + 2 + 23)
    block_a, block_b = first[:, 5:8], first[:, 12:15]
    for place in (block_a, block_b):
        assert ((place[:, 0] > -0.081) & (place[:, 0] < 0.001)).all()
        assert ((place[:, 1] > -0.001) & (place[:, 1] < 0.081)).all()


def test_a_spec_says_what_is_seen_and_done_without_robosuite_being_imported_here() -> None:
    blind = Robosuite(["Stack"], "Panda", objects=False, joint_noise=0.1).spec("panda")
    assert {key.name.split("_")[0] for key in blind.observation} == {"robot0"}
    assert (blind.action_size, blind.control_hz) == (7, 20.0)
    assert "joint noise 0.1 rad" in blind.env
    assert "cubeA_pos" in {key.name for key in Robosuite(["Stack"], "Panda").spec("panda").observation}


def test_an_action_that_is_no_number_is_invalid() -> None:
    run(EPISODES[:2], np.zeros((0, 2, 7), np.float32))
    moves = np.zeros((2, 7), np.float32)
    moves[1] = np.inf
    assert simulator().step(moves, np.array([0, 1])).invalid.tolist() == [False, True]
