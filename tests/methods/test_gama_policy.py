from __future__ import annotations

import json

import numpy as np
import pytest
import tiny
import torch
from torch import Tensor

from datamodules import settings
from datamodules.types import Observation
from plp_lightning.methods.gama.phases import TransitionDiscriminator
from plp_lightning.methods.gama.policy import GamaPolicy, TargetDynamics
from plp_lightning.networks import with_frozen_parameters

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
    decided = policy.predict_actions(observation, task)
    for row in range(4):
        one_hot = torch.eye(3)[task["large"][row]]
        own = policy.perception.scaler(observation["small"].state[row], "small")
        acted = policy.source_policy.net(torch.cat([own, one_hot])).tanh()
        torch.testing.assert_close(decided["small"][row], acted)
        state = policy.perception.scaler(observation["large"].state[row], "large")
        there = policy.source_policy.net(torch.cat([policy.state_map.net(state), one_hot])).tanh()
        back = policy.action_map.net(torch.cat([there, state]) if action_map_state else there).tanh()
        torch.testing.assert_close(decided["large"][row], back)


def test_alignment_is_scored_in_states_of_the_source() -> None:
    policy = build()
    observation, _ = inputs()
    encoded = policy.encode(observation)
    assert torch.equal(encoded["small"], policy.perception.scaler(observation["small"].state, "small"))
    expected = policy.state_map(policy.perception.scaler(observation["large"].state, "large"))
    torch.testing.assert_close(encoded["large"], expected)
    assert encoded["large"].shape == (4, 3)


@pytest.mark.parametrize("action_map_state", [False, True])
def test_the_action_map_sees_the_state_if_it_is_told_to(action_map_state: bool) -> None:
    policy, action = build(action_map_state), torch.randn(1, 2).expand(2, 2)
    first, second = policy.translate(action, torch.randn(2, 7))
    assert torch.equal(first, second) is not action_map_state


def test_its_recipe_rebuilds_the_policy_after_json() -> None:
    policy = build(action_map_state=True)
    plain = json.loads(json.dumps(settings.blueprint(policy, ["problem"])))
    again = settings.build(plain, GamaPolicy, ["plp_lightning"], policy.problem)
    again.load_state_dict(policy.state_dict())
    observation, task = inputs()
    assert torch.equal(
        policy.predict_actions(observation, task)["large"], again.predict_actions(observation, task)["large"]
    )


def test_acting_is_deciding() -> None:
    policy, state = build(), np.random.default_rng(0).normal(size=(3, 7)).astype(np.float32)
    acted = policy.act(Observation(state), "large", ["lift", "reach", "push"])
    decided = policy.predict_actions({"large": tiny.observe(state)}, {"large": torch.tensor([2, 0, 1])})["large"]
    np.testing.assert_array_equal(acted, decided.detach().numpy())


def test_what_is_foreseen_teaches_the_dynamics_nothing() -> None:
    dynamics, state, action = TargetDynamics(3, 2, 8, 1), torch.randn(4, 3), torch.randn(4, 2, requires_grad=True)
    foreseen = with_frozen_parameters(dynamics)(state, action)
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
    logits = with_frozen_parameters(judge)(transition)
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
