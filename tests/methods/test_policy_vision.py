"""A policy that sees: where images come in, and that nothing else changes."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tiny
import torch
from torch import Tensor

from datamodules import settings
from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.networks import ImageEncoding

TASKS = ["reach", "push", "lift"]


def camera(name: str, state: int, actions: int, sides: tuple[int, int] = (8, 6)) -> DomainSpec:
    keys = (ObservationKey("camera", (*sides, 3), kind="image"), *tiny.spec(name, state, actions).observation)
    return DomainSpec(name, keys, actions, control_hz=10.0)


LEFT, RIGHT, BLIND = camera("left", 2, 2), camera("right", 4, 3), tiny.spec("blind", 3, 1)


def build(
    *domains: DomainSpec, image_channels: tuple[int, ...] = (4, 6), decoder_state: object = "none"
) -> PortablePolicy:
    torch.manual_seed(0)
    return PortablePolicy(
        tiny.problem(domains, TASKS, {spec.name: tiny.statistics(spec, i) for i, spec in enumerate(domains)}),
        latent=6,
        hidden=8,
        image_encoder=ImageEncoding(image_channels, 5),
        decoder_state=decoder_state,  # type: ignore[arg-type]
    )


def inputs(*domains: DomainSpec, count: int = 3) -> tuple[dict[str, Observation[Tensor]], dict[str, Tensor]]:
    draw = torch.Generator().manual_seed(1)
    observation = {}
    for spec in domains:
        shapes = {key.name: (count, *key.shape) for key in spec.image_keys}
        images = {n: torch.randint(0, 256, shape, dtype=torch.uint8, generator=draw) for n, shape in shapes.items()}
        observation[spec.name] = Observation(torch.randn(count, spec.state_size, generator=draw), images)
    return observation, {spec.name: torch.arange(count) % 3 for spec in domains}


def test_the_vector_of_the_image_joins_the_scaled_state_and_the_domain() -> None:
    policy = build(LEFT, RIGHT)
    observation, _ = inputs(LEFT, RIGHT)
    assert policy.image_encoder is not None
    for i, spec in enumerate((LEFT, RIGHT)):
        seen = observation[spec.name]
        state = torch.zeros(3, LEFT.state_size + RIGHT.state_size)
        first = [0, LEFT.state_size][i]
        state[:, first : first + spec.state_size] = policy.scaler(seen.state, spec.name)
        domain = torch.eye(2)[i].expand(3, -1)
        by_hand = policy.encoder.net(
            torch.cat([state, domain, policy.image_encoder["8x6x3"](seen.images["camera"])], dim=1)
        )
        torch.testing.assert_close(policy.encode(observation)[spec.name], by_hand)


@pytest.mark.parametrize("decoder_state", ["none", "all"])
def test_all_domains_are_looked_at_in_one_pass(decoder_state: str) -> None:
    policy, seen = build(LEFT, RIGHT, decoder_state=decoder_state), []
    assert policy.image_encoder is not None
    policy.image_encoder["8x6x3"].register_forward_hook(lambda module, args, out: seen.append(tuple(args[0].shape)))
    policy(*inputs(LEFT, RIGHT))
    assert seen == [(6, 8, 6, 3)]


def test_a_domain_without_a_camera_has_zeros_in_its_place() -> None:
    policy = build(BLIND, LEFT)
    observation, task = inputs(BLIND, LEFT)
    seen = observation["blind"]
    parts = (policy.scaler(seen.state, "blind"), torch.zeros(3, LEFT.state_size), torch.eye(2)[0].expand(3, -1))
    padded = torch.cat([*parts, torch.zeros(3, 5)], dim=1)
    latent = policy.encode(observation)
    torch.testing.assert_close(latent["blind"], policy.encoder.net(padded))
    torch.testing.assert_close(policy.encode({"blind": seen})["blind"], latent["blind"])
    torch.testing.assert_close(policy.encode({"left": observation["left"]})["left"], latent["left"])
    assert policy(observation, task).action["blind"].shape == (3, 1)


@pytest.mark.parametrize(
    ("decoder_state", "state", "image"),
    [("none", False, False), ("proprioception", True, False), (["b"], True, False), ("all", True, True)],
)
def test_the_decoder_sees_what_it_is_told_to(decoder_state: str | list[str], state: bool, image: bool) -> None:
    policy = build(LEFT, RIGHT, decoder_state=decoder_state)
    observation, _ = inputs(LEFT, RIGHT)
    plan = {domain: torch.ones(3, 6) for domain in observation}
    actions = policy.decode(plan, observation)
    dark = {d: o._replace(images=o.map(torch.zeros_like).images) for d, o in observation.items()}
    changed = [not torch.equal(actions[d], action) for d, action in policy.decode(plan, dark).items()]
    assert changed == [image] * 2
    still = {d: Observation(torch.zeros_like(o.state), o.images) for d, o in observation.items()}
    changed = [not torch.equal(actions[d], action) for d, action in policy.decode(plan, still).items()]
    assert changed == [state] * 2


def test_a_decoder_that_sees_images_gets_the_vector_that_the_encoder_gets() -> None:
    policy = build(LEFT, BLIND, decoder_state="all")
    observation, _ = inputs(LEFT, BLIND)
    plan = {domain: torch.ones(3, 6) for domain in observation}
    assert policy.image_encoder is not None
    for i, (domain, obs) in enumerate(observation.items()):
        state = torch.zeros(3, LEFT.state_size + BLIND.state_size)
        first = [0, LEFT.state_size][i]
        state[:, first : first + obs.state.shape[1]] = policy.scaler(obs.state, domain)
        vector = policy.image_encoder["8x6x3"](obs.images["camera"]) if obs.images else torch.zeros(3, 5)
        by_hand = policy.decoder(plan[domain], torch.cat([state, torch.eye(2)[i].expand(3, -1), vector], dim=1))
        torch.testing.assert_close(policy.decode(plan, observation)[domain], policy.actions.take(by_hand, domain))


def test_an_image_is_no_key_of_the_state() -> None:
    with pytest.raises(UserError, match="decoder_state names 'camera'; expected state keys: a, b"):
        build(LEFT, decoder_state=["camera"])


def test_without_channels_the_policy_is_blind() -> None:
    policy = build(LEFT, RIGHT, image_channels=())
    observation, task = inputs(LEFT, RIGHT)
    assert policy.image_encoder is None
    dark = {d: Observation(o.state) for d, o in observation.items()}
    assert torch.equal(policy(observation, task).action["left"], policy(dark, task).action["left"])


def test_policies_without_cameras_have_the_weights_they_always_had() -> None:
    plain = {d: tiny.spec(d, s, 2) for d, s in (("x", 2), ("y", 4))}
    seeing, blind = build(*plain.values()), build(*plain.values(), image_channels=())
    assert seeing.image_encoder is None
    assert seeing.state_dict().keys() == blind.state_dict().keys()
    assert all(torch.equal(value, blind.state_dict()[name]) for name, value in seeing.state_dict().items())


def test_an_image_that_is_missing_is_noticed() -> None:
    policy = build(LEFT, RIGHT)
    observation, _ = inputs(LEFT, RIGHT)
    with pytest.raises(UserError, match=r"no images of camera 'camera' in domain 'left'; give them beside the state"):
        policy.encode(observation | {"left": Observation(observation["left"].state)})


def test_acting_needs_numpy_images_alone() -> None:
    policy = build(LEFT, RIGHT)
    observation, _ = inputs(LEFT, RIGHT)
    found = policy.act(observation["right"].map(np.asarray), "right", TASKS)
    by_hand = policy({"right": observation["right"]}, {"right": torch.arange(3)}).action["right"]
    torch.testing.assert_close(torch.from_numpy(found), by_hand.detach())


def test_its_recipe_rebuilds_a_policy_that_sees_after_json() -> None:
    policy = build(LEFT, RIGHT)
    plain = json.loads(json.dumps(settings.blueprint(policy, ["problem"])))
    again = settings.build(plain, PortablePolicy, ["plp_lightning"], tiny.problem([LEFT, RIGHT], TASKS))
    again.load_state_dict(policy.state_dict())
    assert settings.blueprint(again, ["problem"]) == settings.blueprint(policy, ["problem"])
    observation, task = inputs(LEFT, RIGHT)
    assert torch.equal(again(observation, task).action["left"], policy(observation, task).action["left"])
