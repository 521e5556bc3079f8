from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
import tiny
import torch
from torch import Tensor, nn

from datamodules.amounts import Batching, Demonstrations
from datamodules.errors import ConfigError
from datamodules.problem import TransferRoles
from datamodules.store.writer import write_trajectories
from datamodules.transfer import TransferDataModule
from datamodules.types import Observation, Trajectory
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert, SeenPoint
from plp_lightning.evaluation.scores import (
    AlignmentScore,
    ClosenessScore,
    PairAccuracy,
    encode,
    guided_states,
    partners,
    sample_states,
)

SIMULATORS = {name: domain.simulator for name, domain in tiny.domains().items()}


class Oracle(nn.Module):
    """Encodes a state as the point in the plane that it shows, or as noise."""

    def __init__(self, blind: bool) -> None:
        super().__init__()
        self.blind, self.weight = blind, nn.Parameter(torch.zeros(1))

    def encode(self, observation: dict[str, Observation[Tensor]]) -> dict[str, Tensor]:
        ((domain, seen),) = observation.items()
        simulator = SIMULATORS[domain]
        assert isinstance(simulator, LinearPoint)
        plane = torch.from_numpy(simulator.shared_position(seen.state.numpy())).float()
        noise = torch.Generator().manual_seed(len(domain) + seen.state.shape[1])
        return {domain: torch.randn(plane.shape, generator=noise) if self.blind else plane}


def test_latents_of_corresponding_states_are_close_if_the_encoder_knows_the_maps(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    scores = [ClosenessScore(200)(Oracle(blind), data, SIMULATORS)["closeness"] for blind in (False, True)]
    assert scores[0] > 0.99
    assert scores[1] == pytest.approx(0.05, abs=0.05)


def test_scored_states_are_proxy_states_of_both_parts_and_always_the_same(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    for domain, dataset in data.datasets.items():
        sample = sample_states(data, domain, 50).state
        assert torch.equal(sample, sample_states(data, domain, 50).state)
        proxy = dataset.observation.state[: len(dataset)][dataset.task != tiny.TASKS.index(tiny.TARGET)]
        assert len(sample) == 50
        assert {tuple(row) for row in sample.tolist()} <= {tuple(row) for row in proxy.tolist()}
        everything = sample_states(data, domain, 10**6).state
        np.testing.assert_array_equal(np.sort(everything, axis=0), np.sort(proxy, axis=0))


def test_scores_are_the_same_for_every_seed_of_a_run(trajectory_file: Path) -> None:
    one, other = (sample_states(tiny.data_module(trajectory_file, seed=s), "tall", 20).state for s in (0, 1))
    assert torch.equal(one, other)


def test_encoding_is_the_policys_encoder_without_gradients(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    policy, seen = tiny.policy(data), data.datasets["tall"].observation.take(slice(5))
    found = encode(policy, "tall", seen)
    assert torch.equal(found, policy.encode({"tall": seen})["tall"])
    assert not found.requires_grad


def test_partners_of_point_mazes_show_the_same_physics() -> None:
    plain, mirrored = PointMaze("umaze"), PointMaze("umaze", swap_axes=True, negate_actions=True)
    state = np.array([[1.0, 2.0, 3.0, 4.0]])
    assert partners(state, plain, mirrored).tolist() == [[2.0, 1.0, 4.0, 3.0]]
    assert partners(partners(state, plain, mirrored), mirrored, plain).tolist() == state.tolist()


def point_data(path: Path) -> TransferDataModule:
    """Made-up states of two point mazes, those of the target task in the target domain marked by 99."""
    mazes, rng, made = POINTS, np.random.default_rng(0), []
    tasks = ("s0_g_3_1", "s1_g_1_1")
    for name in mazes:
        for task, seed in itertools.product(tasks, range(3)):
            states = rng.normal(size=(5, 4)).astype(np.float32)
            states[task == tasks[1]] = 99
            actions = np.zeros((5, 2), dtype=np.float32)
            made.append(Trajectory(name, task, Observation(states), actions, seed, success=True))
    write_trajectories(path, [maze.spec(name) for name, maze in mazes.items()], tasks, made, {"command": "tests"})
    roles = TransferRoles(tuple(mazes), *mazes, tasks, tasks[:1], "goal_1_1", tasks[1:])
    return TransferDataModule(path, roles, Demonstrations(trajectories=3, target_trajectories=3), Batching())


POINTS = {"mirrored": PointMaze("umaze", swap_axes=True, negate_actions=True), "point": PointMaze("umaze")}


def test_pairs_of_point_mazes_correspond_exactly(tmp_path: Path) -> None:
    data = point_data(tmp_path / "points.hdf5")
    pairs = PairAccuracy(5).correspondences(data, POINTS, 7)
    assert list(pairs) == ["mirrored", "point"]
    assert pairs["mirrored"].state.shape == (7, 4)
    assert torch.equal(pairs["mirrored"].state, pairs["point"].state[:, [1, 0, 3, 2]])
    assert torch.equal(pairs["point"].state, sample_states(data, "point", 7).state)
    assert not (pairs["point"].state == 99).any()


def test_closest_states_correspond_one_to_one(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    pairs = ClosenessScore(9).correspondences(data, SIMULATORS, 4)
    assert list(pairs) == ["flat", "tall"]
    here, there = (SIMULATORS[domain].shared_position(seen.state.numpy()) for domain, seen in pairs.items())
    many = SIMULATORS["tall"].shared_position(sample_states(data, "tall", 9).state.numpy())
    gaps = np.linalg.norm(here[:, None] - many[None], axis=2)
    least = min(gaps[range(4), list(chosen)].sum() for chosen in itertools.permutations(range(9), 4))
    assert np.linalg.norm(here - there, axis=1).sum() == pytest.approx(least)
    assert len(np.unique(there, axis=0)) == 4
    assert torch.equal(pairs["flat"].state, sample_states(data, "flat", 4).state)


def test_there_are_no_more_pairs_than_states(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    assert {len(seen.state) for seen in ClosenessScore(3).correspondences(data, SIMULATORS, 8).values()} == {3}


def test_a_score_of_ones_own_need_not_know_correspondences(trajectory_file: Path) -> None:
    class Constant(AlignmentScore):
        def __call__(self, policy: object, data: object, simulators: object) -> dict[str, float]:
            return {"constant": 1.0}

    assert Constant().correspondences(tiny.data_module(trajectory_file), SIMULATORS, 4) is None


def test_true_pairs_are_known_for_point_mazes_alone(trajectory_file: Path) -> None:
    data = tiny.data_module(trajectory_file)
    with pytest.raises(ConfigError, match="PairAccuracy is for two domains of PointMaze"):
        PairAccuracy(50)(Oracle(blind=False), data, SIMULATORS)
    with pytest.raises(ConfigError, match="expected ClosenessScore for others"):
        PairAccuracy(50).correspondences(data, SIMULATORS, 20)


def test_states_of_the_target_task_are_scored_apart(trajectory_file: Path) -> None:
    data, guide = tiny.data_module(trajectory_file), LinearPointExpert()
    scores = [ClosenessScore(400, guide, 60).of_target(Oracle(blind), data, SIMULATORS) for blind in (False, True)]
    assert [[*score] for score in scores] == [["closeness_target"]] * 2
    assert scores[0]["closeness_target"] > 0.95
    assert scores[1]["closeness_target"] == pytest.approx(0.05, abs=0.05)
    assert ClosenessScore(200).of_target(Oracle(blind=False), data, SIMULATORS) == {}
    assert PairAccuracy(5).of_target(Oracle(blind=False), data, SIMULATORS) == {}


def test_guided_states_are_those_of_the_experts_episodes_and_always_the_same() -> None:
    simulator, guide = SeenPoint(1, image_size=9), LinearPointExpert()
    few, again = (guided_states(simulator, guide, "left", ["red"], 3, 7) for _ in range(2))
    everything = guided_states(simulator, guide, "left", ["red"], 3, 10**6)
    assert few.state.shape == (7, 4)
    assert few.images["camera"].shape == (7, 9, 9, 3)
    assert torch.equal(few.state, again.state)
    assert torch.equal(few.images["camera"], again.images["camera"])
    assert torch.equal(everything.images["camera"][:7], few.images["camera"])
    # Three episodes from near the centre to a goal at distance 1.
    distance = np.linalg.norm(simulator.shared_position(everything.state.numpy()), axis=1)
    assert len(distance) > 3
    assert distance.min() < 0.5 < distance.max() < 1.2


def test_guided_states_of_a_domain_without_a_camera_have_no_images() -> None:
    found = guided_states(LinearPoint(1), LinearPointExpert(), "flat", ["goal_0", "goal_1"], 3, 5)
    assert found.images == {}
    assert len(found.state) == 5


def test_a_guide_needs_an_episode() -> None:
    with pytest.raises(ConfigError, match=r"ClosenessScore\.guided_episodes is 0; expected a whole number, at least 1"):
        ClosenessScore(guided_episodes=0)
