"""Meta-World by name against the library's own loop, and the promises of a simulator."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest

from datamodules.errors import ConfigError
from datamodules.types import Observation
from plp_lightning.envs import LinearPoint, MetaWorld
from plp_lightning.envs.experts import MetaWorldExpert
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.suites.metaworld import OFFERED
from plp_lightning.envs.suites.metaworld_world import NAMES, MetaWorldWorld
from plp_lightning.envs.suites.pictures import upright
from plp_lightning.envs.suites.variant import Variant

TASKS = ["door-open-v3", "door-close-v3", "door-open-v3_x0y1"]
EPISODES = [(TASKS[0], 3), (TASKS[1], 4), (TASKS[2], 3), (TASKS[0], 5)]


@cache
def simulator(threads: int = 1, camera: str = "") -> MetaWorld:
    """One that tests share, since each reset begins anew."""
    return MetaWorld(TASKS, cameras=[camera] if camera else None, image_size=16, threads=threads, objects=not camera)


def run(world: MetaWorld, episodes: Sequence[tuple[str, int]], actions: np.ndarray) -> list[Observation[np.ndarray]]:
    """All that is seen under ``actions`` ``(T, E, 4)``."""
    rows = np.arange(len(episodes))
    first = world.reset([task for task, _ in episodes], [seed for _, seed in episodes])
    return [first, *(world.step(action, rows).observation for action in actions)]


def actions(steps: int, episodes: int = 1) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.2, 1.2, (steps, episodes, 4)).astype(np.float32)


def library_env(name: str, seed: int) -> Any:
    """The library's own environment, never used before, with kinematics as fresh as ours."""
    from metaworld.env_dict import ALL_V3_ENVIRONMENTS

    env: Any = ALL_V3_ENVIRONMENTS[name]()
    env._set_task_called, env._freeze_rand_vec, env.seeded_rand_vec = True, False, True
    env._partially_observable, env.np_random = False, np.random.default_rng(seed)
    vars(env).pop("sawyer_observation_space", None)
    mujoco.mj_resetData(env.model, env.data)
    env.reset_model()
    mujoco.mj_forward(env.model, env.data)
    env._prev_obs = env._get_curr_obs_combined_no_goal()
    return env


@pytest.mark.parametrize("name", ["door-open-v3", "pick-place-v3"])
def test_steps_are_the_librarys_bit_for_bit_though_episodes_are_swapped(name: str) -> None:
    env, world = library_env(name, 7), MetaWorldWorld(name, tuple(range(39)))
    world.clear()
    world.begin(Variant.of(name, 2), np.random.default_rng(7))
    episode, solved = world.take(), []
    for _ in range(90):
        world.clear()
        world.put(episode)
        action = world.demonstrate()
        world.act(action)
        seen, *_, info = env.step(action)
        np.testing.assert_array_equal(world.observe(), seen)
        solved.append(world.solved())
        assert solved[-1] == bool(info["success"])
        episode = world.take()
    assert solved[-1]
    assert not solved[0]


@pytest.mark.parametrize("name", ["hammer-v3", "stick-push-v3"])  # two objects; success by touch
def test_senses_are_the_librarys_bit_for_bit(name: str) -> None:
    world, felt = MetaWorldWorld(name, tuple(range(39))), set()
    world.begin(Variant.of(name, 2), np.random.default_rng(3))
    env, library, things = world.env, type(world.env), range(world.model.ngeom)
    for _ in range(60):
        world.act(world.demonstrate())
        np.testing.assert_array_equal(env._get_curr_obs_combined_no_goal(), library._get_curr_obs_combined_no_goal(env))
        pressed = [bool(library.touching_object(env, thing)) for thing in things]
        assert [env.touching_object(thing) for thing in things] == pressed
        felt |= {*pressed}
    assert felt == {False, True}


def test_an_episode_is_the_same_alone_in_company_in_used_environments_and_in_other_processes() -> None:
    moves = actions(8, len(EPISODES))
    together = run(simulator(), EPISODES, moves)
    elsewhere = run(simulator(threads=2), EPISODES, moves)
    for i, episode in enumerate(EPISODES):
        alone = run(simulator(), [episode], moves[:, i : i + 1])
        for one, all_of_them, others in zip(alone, together, elsewhere, strict=True):
            np.testing.assert_array_equal(one.state[0], all_of_them.state[i])
            np.testing.assert_array_equal(one.state[0], others.state[i])


def test_a_region_is_where_an_episode_begins() -> None:
    seeds = range(12)
    anywhere, there = (run(simulator(), [(task, s) for s in seeds], actions(0, 12))[0] for task in (TASKS[0], TASKS[2]))
    places = [seen.state[:, simulator().spec("").columns(["object_pos"])] for seen in (anywhere, there)]
    (middle_x, middle_y) = (places[0].min(axis=0)[:2] + places[0].max(axis=0)[:2]) / 2
    assert (places[1][:, 0] < middle_x + 0.02).all()
    assert (places[1][:, 1] > middle_y - 0.02).all()


def test_keys_are_the_librarys_by_name_with_or_without_objects() -> None:
    assert sum(key.shape[0] for key in OFFERED) == MetaWorld(TASKS).spec("").state_size == 39
    blind = MetaWorld(TASKS, objects=False, threads=1)
    assert [key.name for key in blind.spec("").observation] == [
        *("hand_pos", "gripper", "last_hand_pos", "last_gripper"),
    ]
    chosen = MetaWorld(TASKS, state=["goal_pos", "hand_pos"], threads=1)
    seen, whole = (run(world, EPISODES[:1], actions(3))[-1].state[0] for world in (chosen, simulator()))
    np.testing.assert_array_equal(seen, np.concatenate([whole[36:], whole[:3]]))


def test_scripted_policies_solve_their_tasks() -> None:
    expert, tasks, seeds = MetaWorldExpert(), [*TASKS, *TASKS], [*range(6)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        expert.begin(simulator(), tasks, seeds)
        assert rollout(simulator(), expert.act, tasks, seeds).success.all()
    with pytest.raises(ConfigError, match="expected MetaWorld"):
        expert.check(object.__new__(LinearPoint))


def test_cameras_stand_upright_and_see_their_episode() -> None:
    world, moves = simulator(camera="corner2"), actions(2, 2)
    seen = run(world, [(TASKS[0], 0), (TASKS[0], 1)], moves)
    images = [one.images["corner2"] for one in seen]
    assert images[0].shape == (2, 16, 16, 3)
    assert (images[0][0] != images[0][1]).any(), "doors stand elsewhere"
    assert (images[0][0] != images[-1][0]).any(), "the hand has moved"
    again = run(world, [(TASKS[0], 1)], moves[:, 1:])
    np.testing.assert_array_equal(again[-1].images["corner2"][0], images[-1][1])
    assert world.render(np.array([0]), (24, 32)).shape == (1, 24, 32, 3)
    model = upright(MetaWorldWorld(TASKS[0], ()).scene().compile())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (data.cam_xmat[:, 7] > -0.1).all()


def test_what_diverges_is_invalid_and_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run(simulator(), EPISODES[:2], actions(2, 2))[-1]
    act = MetaWorldWorld.act

    def blow_up(world: MetaWorldWorld, action: np.ndarray) -> None:
        act(world, action)
        world.data.qvel[:] = np.nan if action[0] > 0 else world.data.qvel

    monkeypatch.setattr(MetaWorldWorld, "act", blow_up)
    lost = simulator().step(np.array([[1, 0, 0, 0], [-1, 0, 0, 0]], np.float32), np.array([0, 1]))
    assert lost.invalid.tolist() == [True, False]
    np.testing.assert_array_equal(lost.observation.state[0], before.state[0])
    nothing = simulator().step(np.full((1, 4), np.nan, np.float32), np.array([1]))
    assert nothing.invalid.tolist() == [True]


def test_all_fifty_are_there() -> None:
    assert len(NAMES) == 50
