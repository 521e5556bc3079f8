from __future__ import annotations

import json

import numpy as np
import pytest
import seen
import tiny
import torch
from torch import Tensor

from datamodules.errors import ConfigError
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.baselines.gama.networks import SpatialEncoder, TargetDynamics, TransitionDiscriminator
from plp_lightning.baselines.gama.policy import GamaPolicy

SOURCE, TARGET = tiny.spec("small", 3, 2), tiny.spec("large", 7, 5)
TASKS = ("reach", "push", "lift")


def build(action_map_state: bool = False) -> GamaPolicy:
    torch.manual_seed(0)
    statistics = {spec.name: tiny.statistics(spec, i) for i, spec in enumerate((SOURCE, TARGET))}
    return GamaPolicy(tiny.problem([SOURCE, TARGET], TASKS, statistics), hidden=12, action_map_state=action_map_state)


def inputs(rows: int = 4) -> tuple[dict[str, Observation[Tensor]], dict[str, Tensor]]:
    rng = torch.Generator().manual_seed(1)
    states = {spec.name: torch.randn(rows, spec.state_size, generator=rng) for spec in (SOURCE, TARGET)}
    return {name: Observation(state) for name, state in states.items()}, dict.fromkeys(states, torch.arange(rows) % 3)


@pytest.mark.parametrize("action_map_state", [False, True])
def test_the_target_is_translated_there_and_back(action_map_state: bool) -> None:
    policy = build(action_map_state)
    observation, task = inputs()
    decided = policy.decide(observation, task)
    for row in range(4):
        one_hot = torch.eye(3)[task["large"][row]]
        own = policy.scaler(observation["small"].state[row], "small")
        acted = policy.source_policy.net(torch.cat([own, one_hot])).tanh()
        torch.testing.assert_close(decided["small"][row], acted)
        state = policy.scaler(observation["large"].state[row], "large")
        there = policy.source_policy.net(torch.cat([policy.state_map.net(state), one_hot])).tanh()
        back = policy.action_map.net(torch.cat([there, state]) if action_map_state else there).tanh()
        torch.testing.assert_close(decided["large"][row], back)


def test_alignment_is_scored_in_states_of_the_source() -> None:
    policy = build()
    observation, _ = inputs()
    encoded = policy.encode(observation)
    assert torch.equal(encoded["small"], policy.scaler(observation["small"].state, "small"))
    expected = policy.state_map(policy.scaler(observation["large"].state, "large"))
    torch.testing.assert_close(encoded["large"], expected)
    assert encoded["large"].shape == (4, 3)


@pytest.mark.parametrize("action_map_state", [False, True])
def test_the_action_map_sees_the_state_if_it_is_told_to(action_map_state: bool) -> None:
    policy, action = build(action_map_state), torch.randn(1, 2).expand(2, 2)
    first, second = policy.translate(action, torch.randn(2, 7))
    assert torch.equal(first, second) is not action_map_state


@pytest.mark.parametrize("names", [("small",), ("small", "large", "third")])
def test_only_two_domains_can_be_translated(names: tuple[str, ...]) -> None:
    problem = tiny.problem([tiny.spec(name, 3, 2) for name in names], TASKS)
    message = f"translates between two domains, found {', '.join(names)}; leave all but source and target domain away"
    with pytest.raises(ConfigError, match=message):
        GamaPolicy(problem)


def test_the_architecture_rebuilds_the_policy_after_json() -> None:
    policy = build(action_map_state=True)
    again = GamaPolicy(policy.problem, **json.loads(json.dumps(policy.architecture)))
    again.load_state_dict(policy.state_dict())
    observation, task = inputs()
    assert torch.equal(policy.decide(observation, task)["large"], again.decide(observation, task)["large"])


def test_acting_is_deciding() -> None:
    policy, state = build(), np.random.default_rng(0).normal(size=(3, 7)).astype(np.float32)
    acted = policy.act(Observation(state), "large", ["lift", "reach", "push"])
    decided = policy.decide({"large": tiny.observe(state)}, {"large": torch.tensor([2, 0, 1])})["large"]
    np.testing.assert_array_equal(acted, decided.detach().numpy())


def test_what_is_foreseen_teaches_the_dynamics_nothing() -> None:
    dynamics, state, action = TargetDynamics(3, 2, 8, 1), torch.randn(4, 3), torch.randn(4, 2, requires_grad=True)
    foreseen = dynamics.foresee(state, action)
    torch.testing.assert_close(foreseen, dynamics(state, action))
    foreseen.sum().backward()
    assert action.grad is not None
    assert (action.grad != 0).any()
    assert all(parameter.grad is None for parameter in dynamics.parameters())


def test_untrained_dynamics_without_weights_change_nothing() -> None:
    dynamics, state = TargetDynamics(3, 2, 8, 1), torch.randn(4, 3)
    with torch.no_grad():
        dynamics.net[-1].weight.zero_()
        dynamics.net[-1].bias.copy_(torch.tensor([0.0, 1.0, -2.0]))
    torch.testing.assert_close(dynamics(state, torch.randn(4, 2)), state + torch.tensor([0.0, 1.0, -2.0]))


def test_judging_teaches_the_discriminator_nothing() -> None:
    judge, transition = TransitionDiscriminator(3, 2, 4, 8, 1), torch.randn(5, 12, requires_grad=True)
    logits = judge.judge(transition)
    torch.testing.assert_close(logits, judge(transition))
    assert logits.shape == (5,)
    logits.sum().backward()
    assert transition.grad is not None
    assert all(parameter.grad is None for parameter in judge.parameters())


def test_a_transition_is_described_by_its_change_in_typical_units_and_its_task() -> None:
    judge = TransitionDiscriminator(2, 1, 3, 8, 1)
    judge.unit.copy_(torch.tensor([0.5, 10.0]))
    before, after = torch.tensor([[1.0, 2.0]]), torch.tensor([[2.0, -3.0]])
    row = judge.describe(before, torch.tensor([[7.0]]), after, torch.tensor([1]))
    torch.testing.assert_close(row, torch.tensor([[1.0, 2.0, 7.0, 2.0, -0.5, 0.0, 1.0, 0.0]]))


def test_points_are_expected_places_of_a_softmax_over_pixels() -> None:
    torch.manual_seed(0)
    eyes, image = SpatialEncoder((6, 10, 3), [4, 2]), torch.randint(0, 256, (2, 6, 10, 3), dtype=torch.uint8)
    with torch.no_grad():
        eyes.sharpness.fill_(0.7)
    points = eyes(image)
    assert eyes.size == points.shape[1] == 4
    maps = eyes.convolutions(image.permute(0, 3, 1, 2) / 255).detach().double()
    maps = maps.exp() ** float(torch.tensor(0.7).exp())
    assert maps.shape == (2, 2, 3, 5)
    for picture in range(2):
        for channel in range(2):
            share = maps[picture, channel] / maps[picture, channel].sum()
            row = sum(float(share[i].sum()) * place for i, place in enumerate((-1, 0, 1)))
            column = sum(float(share[:, j].sum()) * place for j, place in enumerate((-1, -0.5, 0, 0.5, 1)))
            found = points[picture, 2 * channel : 2 * channel + 2].tolist()
            assert found == pytest.approx([row, column], abs=1e-5)


def test_a_point_follows_what_it_is_a_feature_of() -> None:
    eyes = SpatialEncoder((16, 16, 3), [1])
    with torch.no_grad():
        eyes.convolutions[0].weight.fill_(1.0)
        eyes.sharpness.fill_(3.0)
    image = torch.zeros(2, 16, 16, 3, dtype=torch.uint8)
    image[0, 3:6, 11:14], image[1, 11:14, 3:6] = 255, 255
    first, second = eyes(image)
    assert first[0] < -0.3 < 0.3 < first[1]
    assert second[1] < -0.3 < 0.3 < second[0]


def camera(name: str) -> DomainSpec:
    keys = (ObservationKey("a", (2,)), ObservationKey("camera", (8, 8, 3), "image"))
    return DomainSpec(name, keys, 2, control_hz=10.0)


def test_points_join_the_state_where_there_is_a_camera() -> None:
    policy = GamaPolicy(tiny.problem([SOURCE, camera("seeing")], TASKS), hidden=8, image_channels=[4, 3])
    assert policy.sizes == {"small": 3, "seeing": 8}
    image = torch.randint(0, 256, (5, 8, 8, 3), dtype=torch.uint8)
    observation = Observation(torch.zeros(5, 2), image)
    state = policy.perceive("seeing", observation)
    assert torch.equal(state, torch.cat([torch.zeros(5, 2), policy.eyes["seeing"](image)], dim=1))
    assert policy.encode({"seeing": observation})["seeing"].shape == (5, 3)


def test_each_camera_has_eyes_of_its_own_and_a_blind_policy_has_none() -> None:
    problem = tiny.problem([camera("left"), camera("right")], seen.TASKS)
    assert set(GamaPolicy(problem, hidden=8).eyes) == {"left", "right"}
    blind = GamaPolicy(problem, hidden=8, image_channels=[])
    assert blind.sizes == {"left": 2, "right": 2}
    with pytest.raises(ConfigError, match=r"image_channels is \[4, 0\]; expected at least 1 each"):
        GamaPolicy(problem, image_channels=[4, 0])
