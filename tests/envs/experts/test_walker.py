from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import save_file

from datamodules.errors import CheckpointError, ConfigError
from plp_lightning.envs.base import Domain
from plp_lightning.envs.experts.gait import Gait, Symmetry, gait_path, provenance
from plp_lightning.envs.experts.waypoint import WalkerExpert
from plp_lightning.envs.maze.physics import MazePhysics
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.envs.maze.walker_model import walker_mjcf
from plp_lightning.runs import collection
from plp_lightning.runs.plans import CollectionConfig


def heading(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), np.sin(angle)]])


@pytest.mark.parametrize("legs", [4, 6])
def test_turned_body_moves_as_the_body_does(legs):
    """Walking in direction 0.1 and in a direction k n-ths of a turn further are one motion, turned."""
    walker = MazePhysics(walker_mjcf(legs), threads=1)
    symmetry = Symmetry(legs)
    directions = np.concatenate([heading(0.1 + 2 * np.pi * k / legs) for k in range(legs)])
    walker.begin(legs)
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = np.repeat(rng.uniform(-1, 1, (1, 2 * legs)), legs, axis=0)
        walker.hold(np.arange(legs), symmetry.torques(action, symmetry.turns(directions)), substeps=5)
        seen = symmetry.turn(walker.states[:, walker.physical], directions)
        np.testing.assert_allclose(seen, np.repeat(seen[:1], legs, axis=0), atol=1e-6)
    assert np.abs(seen[0, 5:]).max() > 0.1, "it moved"


def test_turning_by_hand():
    """A quarter turn back: what was y is x, and leg 2 becomes leg 1."""
    state = np.arange(29.0)[None] / 10
    seen = Symmetry(4).turn(state, heading(np.pi / 2))[0]
    np.testing.assert_allclose(seen[:2], [0.2, 0.3], atol=1e-6)  # height and w stay
    np.testing.assert_allclose(seen[2:5], [0.5, -0.4, 0.6], atol=1e-6)
    # Hips and ankles of legs 2, 3, 4, 1; the ankles of legs 2 and 3 bend the other way.
    np.testing.assert_allclose(seen[5:13], [0.9, -1.0, 1.1, -1.2, 1.3, 1.4, 0.7, 0.8], atol=1e-6)
    np.testing.assert_allclose(seen[13:19], [1.6, -1.5, 1.7, 1.9, -1.8, 2.0], atol=1e-6)
    np.testing.assert_allclose(seen[-2:], [1, 0], atol=1e-6)


def test_motors_by_hand():
    """No turn: legs 1 to 4 in order become motors of leg 4, 1, 2, 3."""
    torques = Symmetry(4).torques(np.arange(1.0, 9.0)[None], np.array([0]))
    np.testing.assert_array_equal(torques, [[7, 8, 1, 2, 3, -4, 5, -6]])


@pytest.mark.parametrize("legs", [4, 6])
def test_torques_are_the_same_bit_for_bit_whoever_walks_beside_it(legs):
    gait, rng = Gait.load(gait_path(legs)), np.random.default_rng(0)
    states = rng.normal(size=(40, 13 + 4 * legs)).astype(np.float32)
    directions = np.concatenate([heading(angle) for angle in rng.uniform(-np.pi, np.pi, 40)])
    together = gait.act(states, directions)
    for many in (1, 2, 3, 7, 40):
        parts = [gait.act(states[i : i + many], directions[i : i + many]) for i in range(0, 40, many)]
        np.testing.assert_array_equal(np.concatenate(parts), together)


def test_demonstrations_are_the_same_however_many_are_wanted():
    collection._begin_process({"ant": Domain(WalkerMaze("umaze"), WalkerExpert())}, 1)
    jobs = [collection.Job("ant", "s1_g_1_2", count, frozenset()) for count in (2, 24)]
    few, many = ([t for wave in collection.demonstrate(job, CollectionConfig(noise=0.2)) for t in wave] for job in jobs)
    assert len(few) == 2
    for one, other in zip(few, many, strict=False):
        assert one.seed == other.seed
        np.testing.assert_array_equal(one.observation.state, other.observation.state)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_position_does_not_matter():
    states = np.random.default_rng(0).normal(size=(2, 37))
    states[1, 2:] = states[0, 2:]
    seen = Symmetry(6).turn(states, np.repeat(heading(2.0), 2, axis=0))
    np.testing.assert_array_equal(seen[0], seen[1])


def tiny_gait(path, legs=4):
    features = 13 + 4 * legs
    arrays = {"mean": np.zeros(features), "scale": np.full(features, 2.0)}
    arrays |= {"0.weight": np.eye(3, features, 0), "0.bias": np.zeros(3)}
    arrays |= {"1.weight": np.full((2 * legs, 3), 0.5), "1.bias": np.arange(2.0 * legs)}
    save_file({name: array.astype(np.float32) for name, array in arrays.items()}, path)
    path.with_suffix(".json").write_text(f'{{"legs": {legs}}}')
    return path


def test_network_by_hand(tmp_path):
    gait = Gait.load(tiny_gait(tmp_path / "gait.safetensors"))
    state = np.zeros((1, 29))
    state[0, 2:5] = 0.1, 0.2, 0.3
    first = 0.5 * (np.tanh(0.2) + np.tanh(0.4) + np.tanh(0.6))
    assert first < 1
    # Leg 1's hip gets the first output; all others are at least 1 and clipped; the last leg's motors come first.
    np.testing.assert_allclose(gait.act(state, heading(0.0)), [[1, 1, first, 1, 1, -1, 1, -1]], rtol=1e-6)


def test_missing_gait_says_how_to_train_one(tmp_path):
    with pytest.raises(
        CheckpointError, match=r"no gait at .*; name another file or train one with: plp collect --config"
    ):
        Gait.load(tmp_path / "none.safetensors")


def test_other_file_is_no_gait(tmp_path):
    save_file({"0.weight": np.zeros((2, 2))}, tmp_path / "other.safetensors")
    with pytest.raises(CheckpointError, match=r"is no gait: it lacks '0.bias'; train it again"):
        Gait.load(tmp_path / "other.safetensors")


def test_gait_must_fit_the_body(tmp_path):
    expert = WalkerExpert(tiny_gait(tmp_path / "gait.safetensors", legs=4))
    with pytest.raises(ConfigError, match=r"moves 4 legs, this walker has 6; .* train one with: plp collect"):
        expert.begin(WalkerMaze("umaze", legs=6), ["s0_g_3_1"], [0])
    with pytest.raises(ConfigError, match=r"WalkerExpert demonstrates in WalkerMaze, not in PointMaze"):
        expert.begin(PointMaze("umaze"), ["s0_g_3_1"], [0])


@pytest.mark.parametrize("legs", [4, 6])
def test_gaits_of_the_package_walk(legs):
    maze, expert = WalkerMaze("umaze", legs=legs), WalkerExpert()
    tasks, seeds = list(maze.tasks.names), list(range(21))
    observation, running = maze.reset(tasks, seeds), np.arange(21)
    expert.begin(maze, tasks, seeds)
    success = np.zeros(21, dtype=bool)
    for _ in range(300):
        step = maze.step(expert.act(observation, running), running)
        success[running[step.success]] = True
        observation, running = step.observation.take(~step.success), running[~step.success]
        if len(running) == 0:
            break
    assert success.sum() >= 20


@pytest.mark.parametrize("legs", [4, 6])
def test_gaits_of_the_package_know_where_they_come_from(legs):
    record = provenance(gait_path(legs))
    assert record["legs"] == legs
    assert {"command", "seed", "steps", "versions"} <= set(record)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # stable-baselines3 warns of what it does itself
def test_training_writes_the_policy_it_trained(tmp_path):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from plp_lightning.envs.experts.plane import WalkingOnPlane
    from plp_lightning.envs.experts.train_walker import save_gait, train_walker

    env = VecNormalize(WalkingOnPlane(legs=6, walkers=3, seed=0))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, policy_kwargs={"net_arch": [5]}, device="cpu")
    model.learn(24)
    save_gait(model.policy, env, tmp_path / "gait.safetensors", {"legs": 6})
    states, direction = np.random.default_rng(0).normal(size=(1, 37)), heading(0.3)
    expected, _ = model.predict(env.normalize_obs(Symmetry(6).turn(states, direction)), deterministic=True)
    acted = Gait.load(tmp_path / "gait.safetensors").act(states, direction)
    np.testing.assert_allclose(acted, Symmetry(6).torques(expected, np.array([0])), atol=1e-5)

    out, told = tmp_path / "trained.safetensors", []
    train_walker(4, out, "plp collect", lambda done, note: told.append((done, note)), steps=9000, walkers=64)
    assert Gait.load(out).legs == 4
    record = json.loads(out.with_suffix(".json").read_text())
    assert (record["command"], record["steps"], record["of"]) == ("plp collect", 16384, 9000)
    assert [done for done, _ in told] == [8192, 808]
    assert all("a step, on their feet for" in note for _, note in told)


def test_directions_of_corridors_are_turned_alike():
    """The axes lie 15 degrees or more from where one turn of the spider gives way to the next."""
    for legs, margin in ((4, 44), (6, 14)):
        for axis in np.arange(4) * np.pi / 2:
            around = np.concatenate([heading(axis + np.deg2rad(d)) for d in (-margin, 0, margin)])
            assert len(set(Symmetry(legs).turns(around) % legs)) == 1


@pytest.mark.parametrize("legs", [4, 6])
def test_turned_directions_lie_in_one_sector(legs):
    directions = np.concatenate([heading(angle) for angle in np.linspace(-np.pi, np.pi, 721)])
    seen = Symmetry(legs).turn(np.zeros((721, 13 + 4 * legs)), directions)[:, -2:]
    angles = np.rad2deg(np.arctan2(seen[:, 1], seen[:, 0]))
    middle = 0.0 if legs == 4 else 15.0
    assert np.abs(angles - middle).max() <= 180 / legs + 1e-3
