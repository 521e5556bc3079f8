"""A lab's frame in R2R-Lift: the physics is the same, what is seen and commanded is stated otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from datamodules.types import Observation
from plp_lightning.envs.experts.lift import LiftExpert
from plp_lightning.envs.lift.frame import Frame
from plp_lightning.envs.lift.simulator import Lift

TASKS, ROWS = ["x0y2h0", "x2y1h2"], np.arange(2)
QUARTERS = [1, 2, 3]


def rotated(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector ``(3,)`` turned by a quaternion x, y, z, w."""
    turned: np.ndarray = vector + 2 * np.cross(
        quaternion[:3], np.cross(quaternion[:3], vector) + quaternion[3] * vector
    )
    return turned


def test_a_quarter_turn_makes_forward_what_was_to_the_right() -> None:
    np.testing.assert_array_equal(Frame(1).stated(np.array([[1.0, 2.0, 3.0]])), [[2.0, -1.0, 3.0]])
    np.testing.assert_array_equal(Frame(5).stated(np.array([[1.0, 2.0, 3.0]])), [[2.0, -1.0, 3.0]])


@pytest.mark.parametrize("quarters", QUARTERS)
def test_points_and_poses_are_stated_alike(quarters: int) -> None:
    rng, frame = np.random.default_rng(quarters), Frame(quarters)
    points, poses = rng.normal(size=(4, 3)), rng.normal(size=(4, 4))
    poses /= np.linalg.norm(poses, axis=1, keepdims=True)
    np.testing.assert_array_equal(frame.meant(frame.stated(points)), points)
    for pose, stated, point in zip(poses, frame.stated_pose(poses), points, strict=True):
        np.testing.assert_allclose(rotated(stated, point), frame.stated(rotated(pose, point)[None])[0], atol=1e-12)


@pytest.mark.parametrize("quarters", QUARTERS)
def test_an_episode_is_the_same_but_for_how_hand_and_commands_are_stated(quarters: int) -> None:
    plain, turned, frame = Lift("Sawyer", threads=1), Lift("Sawyer", threads=1, quarter_turns=quarters), Frame(quarters)
    spec, expert, other = plain.spec("d"), LiftExpert(), LiftExpert()
    hand, pose = spec.columns(["eef_pos"]), spec.columns(["eef_quat"])
    seen, stated = plain.reset(TASKS, [0, 1]).state, turned.reset(TASKS, [0, 1]).state
    for own, simulator in ((expert, plain), (other, turned)):
        own.begin(simulator, TASKS, [0, 1])
    for _ in range(10):
        np.testing.assert_allclose(stated[:, hand], frame.stated(seen[:, hand]), atol=1e-6)
        np.testing.assert_allclose(stated[:, pose], frame.stated_pose(seen[:, pose]), atol=1e-6)
        np.testing.assert_allclose(np.delete(stated, hand + pose, 1), np.delete(seen, hand + pose, 1), atol=1e-6)
        np.testing.assert_allclose(turned.shared_position(stated), plain.shared_position(seen), atol=1e-6)
        action = expert.act(Observation(seen), ROWS)
        commanded = other.act(Observation(stated), ROWS)
        np.testing.assert_allclose(commanded[:, :3], frame.stated(action[:, :3]), atol=1e-4)
        seen, stated = (
            simulator.step(acts, ROWS).observation.state for simulator, acts in ((plain, action), (turned, commanded))
        )


def test_demonstrations_of_one_frame_are_not_taken_for_those_of_another() -> None:
    assert len({Lift("Sawyer", quarter_turns=quarters).spec("d").env for quarters in range(4)}) == 4
    assert Lift("Sawyer").spec("d") == Lift("Sawyer", quarter_turns=4).spec("d")
