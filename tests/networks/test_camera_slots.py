"""Cameras of any sizes: who shares an encoder, who shares a slot, and names from when there was one size."""

from __future__ import annotations

import cameras
import pytest
import torch

from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.methods.upgrade import upgrade_checkpoint
from plp_lightning.networks import ImageEncoding, Vision
from plp_lightning.networks.cameras import camera_slots

SMALL = ImageEncoding((2, 3), 5)


def spec(name: str, *names: str, state: int = 1) -> DomainSpec:
    images = tuple(ObservationKey(camera, (4, 4, 3), "image") for camera in names)
    return DomainSpec(name, (ObservationKey("x", (state,)), *images), 1, 10.0)


@pytest.mark.parametrize(
    ("domains", "slots"),
    [
        ((("front",), ("image",)), [[0], [0]]),
        ((("front", "wrist"), ("palm", "wrist")), [[0, 1], [0, 1]]),
        ((("front",), ("wrist", "front")), [[0], [1, 0]]),
        ((("front", "wrist"), ("wrist",)), [[0, 1], [1]]),
        (((), ("a", "b", "c"), ("d",)), [[], [0, 1, 2], [0]]),
        ((("a",), ("b",), ("b", "a")), [[0], [0], [0, 1]]),
    ],
)
def test_names_that_agree_share_a_slot_and_others_the_first_that_is_free(
    domains: tuple[tuple[str, ...], ...], slots: list[list[int]]
) -> None:
    specs = [spec(f"d{i}", *names) for i, names in enumerate(domains)]
    found = camera_slots(specs)
    assert [[found[s.name][key.name] for key in s.image_keys] for s in specs] == slots
    assert all(len({*one.values()}) == len(one) for one in found.values())


def seen(count: int = 2) -> dict[str, Observation[torch.Tensor]]:
    return {s.name: cameras.observations(s, count, i).map(torch.from_numpy) for i, s in enumerate(cameras.DOMAINS)}


def test_each_size_has_an_encoder_and_each_camera_its_slot() -> None:
    vision, images = Vision(cameras.DOMAINS, SMALL), seen()
    assert [*vision] == ["8x12x3", "6x6x1"]
    assert vision.width == 10
    blind, two, eyes = vision(images).split(2)
    assert not blind.any()
    wide, wrist = vision["8x12x3"](images["two"].images["wide"]), vision["6x6x1"](images["two"].images["wrist"])
    torch.testing.assert_close(two, torch.cat([wide, wrist], dim=1))
    torch.testing.assert_close(eyes[:, :5], vision["8x12x3"](images["eyes"].images["wide"]))
    assert not eyes[:, 5:].any()
    assert torch.equal(vision(vision.encode(images)), vision(images))


def test_names_from_when_there_was_one_size_are_understood() -> None:
    one, other = (Vision([spec("a", "eye"), spec("b", "eye")], SMALL) for _ in range(2))
    old = {name.removeprefix("4x4x3."): value for name, value in one.state_dict().items()}
    other.load_state_dict(old)
    assert all(torch.equal(value, other.state_dict()[name]) for name, value in one.state_dict().items())


def test_frozen_parts_of_old_names_are_hashed_anew() -> None:
    for name, kept in (("policy.image_encoder.linear.bias", False), ("policy.image_encoder.4x4x3.linear.bias", True)):
        checkpoint = {"policy": {}, "state_dict": {name: torch.zeros(1)}, "callbacks": {"FreezeGuard": {}}}
        upgrade_checkpoint(checkpoint)
        assert ("FreezeGuard" in checkpoint["callbacks"]) == kept
