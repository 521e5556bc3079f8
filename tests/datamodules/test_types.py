from __future__ import annotations

import json

import numpy as np
import pytest
import tiny

from datamodules.errors import UserError
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory

ARM = DomainSpec(
    "arm",
    (
        ObservationKey("pos", (3,), unit="m"),
        ObservationKey("camera", (4, 5, 3), "image"),
        ObservationKey("grip", (2,)),
    ),
    4,
    20.0,
    "an arm",
)


def test_the_state_is_the_state_keys_end_to_end_without_the_image() -> None:
    assert ARM.state_size == 5
    assert [key.name for key in ARM.state_keys] == ["pos", "grip"]
    assert ARM.image_keys == (ARM.observation[1],)
    assert tiny.spec("x", 3, 2).image_keys == ()


def test_columns_follow_the_order_of_the_names() -> None:
    assert ARM.columns(["grip", "pos"]) == [3, 4, 0, 1, 2]
    assert ARM.columns([]) == []


@pytest.mark.parametrize("name", ["gripp", "camera"])
def test_a_key_that_is_no_state_key_is_refused_with_those_there_are(name: str) -> None:
    with pytest.raises(UserError, match=f"'arm' has no state key '{name}'; it has: pos, grip"):
        ARM.columns([name])


def test_a_domain_may_show_images_alone_but_not_nothing() -> None:
    eye = DomainSpec("eye", (ObservationKey("camera", (4, 4, 3), "image"),), 2, 10.0)
    assert (eye.state_size, eye.state_keys, eye.columns([])) == (0, (), [])
    with pytest.raises(UserError, match="domain 'eye' has no state key 'x'; it has: none"):
        eye.columns(["x"])
    with pytest.raises(UserError, match="domain 'eye' has neither a state key nor a camera"):
        DomainSpec("eye", (), 2, 10.0)


def test_a_spec_survives_json() -> None:
    assert DomainSpec.from_dict(json.loads(json.dumps(ARM.to_dict()))) == ARM


@pytest.mark.parametrize("last", [0, 1])
def test_a_trajectory_knows_whether_what_was_seen_last_is_there(last: int) -> None:
    trajectory = Trajectory("arm", "reach", Observation(np.zeros((2 + last, 5))), np.zeros((2, 4)), 0, True)
    assert (len(trajectory), trajectory.last_known) == (2, last == 1)


@pytest.mark.parametrize(("states", "actions"), [(4, 2), (1, 2), (0, 0), (1, 0)])
def test_a_trajectory_needs_an_observation_for_each_of_its_actions(states: int, actions: int) -> None:
    with pytest.raises(UserError, match=f"task 'reach' in domain 'arm' has {states} observations and {actions} act"):
        Trajectory("arm", "reach", Observation(np.zeros((states, 5))), np.zeros((actions, 4)), 0, True)


def test_take_picks_the_same_rows_of_state_and_image() -> None:
    seen = Observation(np.arange(4)[:, None], {"camera": np.arange(4)[:, None, None, None] * 10})
    taken = seen.take(np.array([2, 0]))
    assert taken.state.ravel().tolist() == [2, 0]
    assert taken.images["camera"].ravel().tolist() == [20, 0]
    assert Observation(np.zeros((3, 2))).take(slice(1)).images == {}
