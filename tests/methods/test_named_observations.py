"""Policies act on what robots give: arrays by name, of any number of rows, in units of their own."""

from __future__ import annotations

import numpy as np
import pytest
import seen
import tiny
import torch

from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.networks import ImageEncoding

ARM = DomainSpec("arm", tiny.spec("arm", 5, 2).observation, 2, 10.0, "", (-6.0, 0.0), (6.0, 4.0))


@pytest.fixture
def policy() -> PortablePolicy:
    torch.manual_seed(0)
    return PortablePolicy(tiny.problem([tiny.spec("leg", 3, 1), ARM], ["x", "y"]), latent=8, hidden=16)


@pytest.mark.parametrize("lead", [(), (1,), (4,), (2, 3)])
def test_rows_of_any_number(lead: tuple[int, ...], policy: PortablePolicy) -> None:
    rng = np.random.default_rng(0)
    named = {"b": rng.normal(size=(*lead, 4)), "a": rng.normal(size=(*lead, 1)), "other": np.zeros(9)}
    state = np.concatenate([named["a"], named["b"]], axis=-1).reshape(-1, 5).astype(np.float32)
    expected = policy.act(Observation(state), "arm", "y")
    found = policy.act(named, "arm", "y")
    assert found.shape == (*lead, 2)
    assert np.array_equal(found.reshape(-1, 2), expected)
    assert (np.abs(expected - [0, 2]) <= [6, 2]).all()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"a": None}, "observation lacks 'a'; domain 'arm' shows a, b"),
        ({"a": np.zeros((2, 2))}, "'a' is of shape (2, 2); expected (…, 1)"),
        ({"a": np.zeros(())}, "'a' is of shape (); expected (…, 1)"),
        ({"a": np.zeros((3, 1))}, "'b' has (2,) rows, 'a' (3,); expected as many of each key"),
    ],
)
def test_what_does_not_fit_is_told(change: dict[str, np.ndarray | None], told: str, policy: PortablePolicy) -> None:
    named = {"a": np.zeros((2, 1)), "b": np.zeros((2, 4))} | change
    given = {name: value for name, value in named.items() if value is not None}
    with pytest.raises(UserError) as found:
        policy.act(given, "arm", "y")
    assert told in str(found.value)


def test_images_have_names_too() -> None:
    specs = [domain.world.spec(name) for name, domain in seen.domains().items()]
    sizes = ImageEncoding((4, 6), 12)
    policy = PortablePolicy(tiny.problem(specs, seen.TASKS), latent=8, hidden=16, image_encoder=sizes)
    spec, types = policy.domains["right"], {"image": np.uint8, "state": np.float64}
    named = {key.name: np.zeros((3, *key.shape), types[key.kind]) for key in spec.observation}
    assert policy.act(named, "right", "red").shape == (3, spec.action_size)
    named["camera"] = named["camera"].astype(float)
    with pytest.raises(UserError, match="'camera' is of type float64; expected uint8"):
        policy.act(named, "right", "red")
