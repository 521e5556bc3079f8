from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import tiny
import torch
from torch import Tensor

from datamodules import settings
from datamodules.batches.normalization import Statistics
from datamodules.errors import ConfigError
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.methods.plp.policy import DecoderState, EncoderState, PortablePolicy
from plp_lightning.networks import Sharing

SMALL, LARGE, TWIN = tiny.spec("small", 3, 2), tiny.spec("large", 7, 5), tiny.spec("twin", 3, 2)
TASKS = ("reach", "push", "lift")


def build(
    domains: Sequence[DomainSpec] = (SMALL, LARGE, TWIN),
    decoder_state: DecoderState = "all",
    statistics: dict[str, Statistics] | None = None,
    columns: Sharing = "own",
    encoder_state: EncoderState = "all",
) -> PortablePolicy:
    torch.manual_seed(0)
    policy = PortablePolicy(
        tiny.problem(domains, TASKS, statistics),
        latent=6,
        hidden=12,
        encoder_state=encoder_state,
        decoder_state=decoder_state,
        columns=columns,
    )
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.mul_(3)  # an untrained policy hardly reacts to its inputs, which would hide mistakes
    return policy


def inputs(*specs: DomainSpec, rows: int = 4) -> tuple[dict[str, Observation[Tensor]], dict[str, Tensor]]:
    rng = torch.Generator().manual_seed(1)
    states = {s.name: torch.randn(rows + i, s.state_size, generator=rng) for i, s in enumerate(specs)}
    tasks = {name: torch.arange(len(state)) % len(TASKS) for name, state in states.items()}
    return {name: Observation(state) for name, state in states.items()}, tasks


def by_hand(policy: PortablePolicy, spec: DomainSpec, state: Tensor, task: int, seen: list[int], own: bool) -> Tensor:
    """The paper's figure for one state, one sum after the other in float64."""
    domains = [SMALL, LARGE, TWIN]
    number = domains.index(spec)
    sizes = {0: [0, 0, 0], 1: [1, 1, 1]}.get(len(seen), [3, 7, 3])

    def padded(values: Tensor, sizes: list[int]) -> list[Tensor]:
        zero, one = torch.zeros((), dtype=torch.float64), torch.ones((), dtype=torch.float64)
        before, width = (sum(sizes[:number]), sum(sizes)) if own else (0, max(sizes))
        after = width - before - len(values)
        return [*[zero] * before, *values.double(), *[zero] * after, *[one if d is spec else zero for d in domains]]

    def run(net: torch.nn.Sequential, x: list[Tensor]) -> list[Tensor]:
        linear = [m for m in net if isinstance(m, torch.nn.Linear)]
        for module in linear:
            weights, biases = module.weight.double(), module.bias.double()
            x = [sum(w * v for w, v in zip(row, x, strict=True)) + b for row, b in zip(weights, biases, strict=True)]
            x = x if module is linear[-1] else [v * 0.5 * (1 + torch.erf(v / 2**0.5)) for v in x]
        return x

    clipped = state.clamp(-5, 5)
    latent = run(policy.encoder.net, padded(clipped, [3, 7, 3]))
    plan = run(policy.common.net, [*latent, *torch.eye(3, dtype=torch.float64)[task]])
    action = run(policy.decoder.net, [*plan, *padded(clipped[seen], sizes)])
    first = [0, 2, 7][number] if own else 0
    return torch.stack(action)[first : first + spec.action_size].tanh()


@pytest.mark.parametrize("columns", ["own", "shared"])
@pytest.mark.parametrize(("decoder_state", "count"), [("none", 0), ("all", None), (["a"], 1)])
def test_the_policy_agrees_with_sums_by_hand(decoder_state: DecoderState, count: int | None, columns: Sharing) -> None:
    policy = build(decoder_state=decoder_state, columns=columns)
    observation, task = inputs(SMALL, LARGE, TWIN, rows=2)
    action = policy(observation, task).action
    for spec in (SMALL, LARGE, TWIN):
        seen = list(range(spec.state_size if count is None else count))
        for row, state in enumerate(observation[spec.name].state):
            expected = by_hand(policy, spec, state, int(task[spec.name][row]), seen, columns == "own")
            torch.testing.assert_close(action[spec.name][row].double(), expected, atol=1e-5, rtol=1e-4)


def test_own_columns_of_a_domain_move_no_other() -> None:
    policy = build(decoder_state="all")
    observation, task = inputs(SMALL, LARGE, TWIN)
    before = policy(observation, task).action
    with torch.no_grad():
        policy.encoder.net[0].weight[:, 3:10] = 100  # the larger domain's, between those of the other two
        policy.decoder.net[0].weight[:, 6 + 3 : 6 + 10] = 100
        policy.decoder.net[-1].weight[2:7] = 100
    after = policy(observation, task).action
    assert [torch.equal(before[name], after[name]) for name in ("small", "large", "twin")] == [True, False, True]


@pytest.mark.parametrize("decoder_state", ["none", "all", ["b"]])
def test_a_domain_is_not_changed_by_another_ones_presence(decoder_state: DecoderState) -> None:
    policy = build(decoder_state=decoder_state)
    observation, task = inputs(SMALL, LARGE, TWIN)
    together = policy(observation, task)
    for name in observation:
        alone = policy({name: observation[name]}, {name: task[name]})
        torch.testing.assert_close(alone.action[name], together.action[name])
        torch.testing.assert_close(alone.latent[name], together.latent[name])


def test_padding_does_not_leak_into_a_smaller_domain() -> None:
    policy = build(decoder_state="all", columns="shared")
    observation, task = inputs(SMALL, LARGE)
    before = policy(observation, task).action
    with torch.no_grad():
        policy.encoder.net[0].weight[:, 3:7] = 100  # columns that only the larger domain fills
        policy.decoder.net[0].weight[:, 6 + 3 : 6 + 7] = 100
        policy.decoder.net[-1].weight[2:] = 100  # actions that only the larger domain takes
        policy.scaler.scale[0, 3:] = policy.scaler.offset[0, 3:] = 100
    after = policy(observation, task).action
    assert torch.equal(before["small"], after["small"])
    assert not torch.allclose(before["large"], after["large"])


def test_no_gradient_reaches_what_only_a_larger_domain_uses() -> None:
    policy = build()
    observation, task = inputs(SMALL)
    policy(observation, task).action["small"].square().sum().backward()
    encoder, decoder = policy.encoder.net[0].weight.grad, policy.decoder.net[-1].weight.grad
    assert encoder[:, 3:7].abs().sum() == 0
    assert encoder[:, :3].abs().sum() > 0
    assert decoder[2:].abs().sum() == 0


def test_the_order_of_domains_in_a_batch_does_not_matter() -> None:
    policy = build()
    observation, task = inputs(SMALL, LARGE, TWIN)
    backwards = {name: observation[name] for name in reversed(observation)}
    one, other = policy(observation, task), policy(backwards, task)
    for name in observation:
        torch.testing.assert_close(one.action[name], other.action[name])
    plan = policy.latent_action(one.latent, task)
    mixed = policy.decode(plan, backwards)
    for name in observation:
        torch.testing.assert_close(one.action[name], mixed[name])


def test_domain_and_task_ids_matter() -> None:
    policy = build(decoder_state="none")
    state = Observation(torch.randn(3, 3))
    out = policy({"small": state, "twin": state}, {"small": torch.tensor([0, 1, 2]), "twin": torch.tensor([0, 1, 2])})
    assert not torch.allclose(out.latent["small"], out.latent["twin"])
    other = policy({"small": state}, {"small": torch.tensor([1, 1, 1])})
    assert torch.equal(other.latent["small"], policy.encode({"small": state})["small"])
    changed = (other.action["small"] - out.action["small"]).abs().sum(dim=1) > 1e-6
    assert changed.tolist() == [True, False, True]


def test_the_decoder_knows_its_domain_too() -> None:
    policy = build(decoder_state="none")
    plan, state = torch.randn(3, 6), Observation(torch.randn(3, 3))
    actions = policy.decode({"small": plan, "twin": plan}, {"small": state, "twin": state})
    assert not torch.allclose(actions["small"], actions["twin"])


def test_the_common_policy_does_not_see_the_domain() -> None:
    latent, task = torch.randn(4, 6), torch.tensor([0, 1, 2, 0])
    plans = build().latent_action({"small": latent, "large": latent}, {"small": task, "large": task})
    assert torch.equal(plans["small"], plans["large"])


@pytest.mark.parametrize(("decoder_state", "moved"), [("none", []), ("all", [0, 1, 2]), (["a"], [0]), (["b"], [1, 2])])
def test_the_decoder_sees_of_the_state_what_it_is_told_to(decoder_state: DecoderState, moved: list[int]) -> None:
    policy = build(decoder_state=decoder_state)
    plan, state = torch.randn(1, 6), torch.zeros(1, 3)
    base = policy.decode({"small": plan}, {"small": Observation(state)})["small"]
    for column in range(3):
        shifted = state.clone()
        shifted[0, column] = 1.0
        action = policy.decode({"small": plan}, {"small": Observation(shifted)})["small"]
        assert torch.equal(action, base) == (column not in moved)


@pytest.mark.parametrize(("encoder_state", "moved"), [("all", [0, 1, 2]), (["a"], [0]), (["b"], [1, 2])])
def test_the_encoder_sees_of_the_state_what_it_is_told_to(encoder_state: EncoderState, moved: list[int]) -> None:
    policy = build(encoder_state=encoder_state)
    state = torch.zeros(1, 3)
    base = policy.encode({"small": Observation(state)})["small"]
    for column in range(3):
        shifted = state.clone()
        shifted[0, column] = 1.0
        latent = policy.encode({"small": Observation(shifted)})["small"]
        assert torch.equal(latent, base) == (column not in moved)


def test_an_unknown_encoder_state_is_refused() -> None:
    with pytest.raises(ConfigError, match="encoder_state is 'none'; expected 'all' or a list of observation keys"):
        build(encoder_state="none")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="encoder_state names 'd'; expected state keys: a, b"):
        build(encoder_state=["d"])


def test_an_unknown_decoder_state_is_refused() -> None:
    with pytest.raises(ConfigError, match="decoder_state is 'some'; expected 'none', 'proprioception', 'all' or a l"):
        build(decoder_state="some")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="decoder_state names 'd'; expected state keys: a, b"):
        build(decoder_state=["a", "d"])


def test_a_domain_shows_the_decoder_those_of_the_named_keys_that_it_has() -> None:
    more = DomainSpec("more", (ObservationKey("a", (1,)), ObservationKey("joints", (2,))), 2, 10.0)
    policy = build((SMALL, more), decoder_state=["a", "joints"])
    assert policy.context_columns == {"small": [0], "more": [0, 1, 2]}


def test_acting_is_the_forward_pass() -> None:
    policy = build(statistics={s.name: tiny.statistics(s, 3) for s in (SMALL, LARGE, TWIN)})
    state = np.random.default_rng(0).normal(size=(5, 7)).astype(np.float32)
    acted = policy.act(Observation(state), "large", ["lift", "reach", "push", "lift", "reach"])
    out = policy({"large": Observation(torch.from_numpy(state))}, {"large": torch.tensor([2, 0, 1, 2, 0])})
    assert acted.shape == (5, 5)
    assert acted.dtype == np.float32
    np.testing.assert_array_equal(acted, out.action["large"].detach().numpy())
    assert all(parameter.grad is None for parameter in policy.parameters())


@pytest.mark.parametrize(("domains", "count"), [((SMALL,), 1), ((SMALL, LARGE), 2), ((SMALL, LARGE, TWIN), 3)])
def test_any_number_of_domains_shares_one_network(domains: tuple[DomainSpec, ...], count: int) -> None:
    policy = build(domains)
    observation, task = inputs(*domains)
    out = policy(observation, task)
    for i, spec in enumerate(domains):
        assert out.action[spec.name].shape == (4 + i, spec.action_size)
        assert out.latent[spec.name].shape == (4 + i, 6)
    assert policy.encoder.net[0].in_features == sum(s.state_size for s in domains) + count
    assert build(domains, columns="shared").encoder.net[0].in_features == max(s.state_size for s in domains) + count


def sizes(first: tuple[int, int], second: tuple[int, int], tasks: int, decoder_state: DecoderState) -> list[int]:
    """Parameters of encoder, common policy and decoder at the paper's widths, where domains share columns."""
    domains = [tiny.spec("x", *first), tiny.spec("y", *second)]
    names = [f"task_{i}" for i in range(tasks)]
    policy = PortablePolicy(
        tiny.problem(domains, names), encoder_layers=3, decoder_state=decoder_state, columns="shared"
    )
    parts = (policy.encoder, policy.common, policy.decoder)
    return [sum(p.numel() for p in part.parameters()) for part in parts]


def test_sizes_of_the_paper() -> None:
    square = 192 * 192 + 192
    # R2R: states 32 and 37, four actions, 27 tasks; the decoder sees no state.
    r2r = [(37 + 2) * 192 + 192 + 3 * square, (192 + 27) * 192 + 192 + 4 * square, 194 * 192 + 192 + 2 * square + 772]
    assert sizes((32, 4), (37, 4), 27, "none") == r2r
    # P2A-medium: states 4 and 29, actions 2 and 8, 104 tasks; the decoder sees all of the state.
    p2a = [(29 + 2) * 192 + 192 + 3 * square, 296 * 192 + 192 + 4 * square, 223 * 192 + 192 + 2 * square + 1544]
    assert sizes((4, 2), (29, 8), 104, "all") == p2a


def test_scaling_travels_with_the_weights() -> None:
    fitted = build(statistics={s.name: tiny.statistics(s, 3) for s in (SMALL, LARGE, TWIN)})
    fresh = build()
    observation, task = inputs(SMALL, LARGE)
    assert not torch.allclose(fitted(observation, task).action["small"], fresh(observation, task).action["small"])
    fresh.load_state_dict(fitted.state_dict())
    assert torch.equal(fitted(observation, task).action["small"], fresh(observation, task).action["small"])


def test_its_recipe_rebuilds_the_policy_after_json() -> None:
    policy = build(decoder_state=["a"])
    plain = json.loads(json.dumps(settings.blueprint(policy, ["problem"])))
    again = settings.build(plain, PortablePolicy, ["plp_lightning"], tiny.problem([SMALL, LARGE, TWIN], TASKS))
    again.load_state_dict(policy.state_dict())
    assert settings.blueprint(again, ["problem"]) == settings.blueprint(policy, ["problem"])


def test_actions_come_in_the_owners_units_but_simulators_get_theirs() -> None:
    state = np.random.default_rng(0).normal(size=(4, 7)).astype(np.float32)
    low, high = np.arange(5) - 5.0, np.arange(5) * 2.0 + 1
    policy = build((SMALL, replace(LARGE, action_low=tuple(low), action_high=tuple(high))))
    policy.load_state_dict(build((SMALL, LARGE)).state_dict())
    scaled = build((SMALL, LARGE)).act(Observation(state), "large", "lift")
    middle = (low + high) / 2 + np.clip(scaled, -1, 1) * (high - low) / 2
    owner = policy.act(Observation(state), "large", "lift")
    np.testing.assert_allclose(owner, middle, rtol=1e-6)
    assert owner.dtype == np.float32
    actor = policy.actor("large", ["lift"] * 4)
    np.testing.assert_array_equal(actor(Observation(state), np.arange(4)), scaled)
