"""Episodes that run again: the same states, in real time; and simulators whose pictures are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from datamodules.errors import ConfigError, UserError
from datamodules.types import DomainSpec, Observation
from plp_lightning.envs import PointMaze
from plp_lightning.envs.faults import SimulatorError
from plp_lightning.envs.rendering import backend
from plp_lightning.envs.synthetic import LinearPoint, SeenPoint
from plp_lightning.pictures.replay import MOST, check_filmable, replay

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (9, 2)).astype(np.float32)
SIZE = (32, 48)


class Fast(LinearPoint):
    """Controlled at another rate, and drawn as its own count of steps."""

    hertz = 100.0

    def spec(self, name: str) -> DomainSpec:
        return replace(super().spec(name), control_hz=self.hertz)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.t = 0
        return super().reset(tasks, seeds)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Any:
        self.t += 1
        return super().step(actions, episodes)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        return np.full((len(episodes), *size, 3), self.t % 256, np.uint8)


class Camera(SeenPoint):
    """Seen by its camera alone."""

    render = None  # type: ignore[assignment]


class Blind(LinearPoint):
    """Not to be seen."""

    render = None  # type: ignore[assignment]


def test_films_are_of_the_states_that_the_actions_lead_to() -> None:
    simulator, other = LinearPoint(1), LinearPoint(1)
    played = replay(simulator, "goal_3", 5, ACTIONS, SIZE)
    other.reset(["goal_0", "goal_3"], [4, 5])  # in other company
    pictures = [other.render(np.array([1]), SIZE)[0]]
    for action in ACTIONS:
        other.step(action[None], np.array([1]))
        pictures.append(other.render(np.array([1]), SIZE)[0])
    np.testing.assert_array_equal(np.stack(played.frames), np.stack(pictures))
    assert (played.rate, played.success, played.frames[0].shape) == (10.0, False, (*SIZE, 3))


@pytest.mark.parametrize(
    ("hertz", "steps", "times", "rate"),
    [
        (100.0, 9, [0, 4, 8, 9], 25.0),
        (20.0, 3, [0, 1, 2, 3], 20.0),
        (1.0, 2, [0, 1, 2], 1.0),
        (80.0, 6, [0, 3, 6], 80 / 3),
        (20.0, 2 * MOST, [*range(0, 2 * MOST + 1, 2)], 10.0),
    ],
)
def test_films_are_in_real_time(
    hertz: float, steps: int, times: list[int], rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Fast, "hertz", hertz)
    played = replay(Fast(1), "goal_3", 5, np.zeros((steps, 2), np.float32), (1, 1))
    assert [int(frame[0, 0, 0]) for frame in played.frames] == [t % 256 for t in times]
    assert played.rate == pytest.approx(rate)


def test_a_camera_is_enough() -> None:
    simulator = Camera(1, image_size=9)
    check_filmable(simulator, "seen", "red", 3, SIZE)
    played = replay(simulator, "red", 3, ACTIONS, SIZE)
    first = SeenPoint(1, image_size=9).reset(["red"], [3]).images["camera"]
    np.testing.assert_array_equal(played.frames[0], first[0])
    assert len(played.frames) == 10


def test_who_cannot_be_seen_is_refused() -> None:
    with pytest.raises(
        ConfigError, match="domain 'tall' cannot be filmed: Blind neither renders nor has a camera; exp"
    ):
        check_filmable(Blind(1), "tall", "goal_3", 3, SIZE)


@pytest.mark.parametrize(
    ("picture", "told"),
    [
        (None, "as NoneType; expected an array of uint8"),
        ([1, 2], "as list"),
        (np.zeros((1, 8, 8, 3)), "as an array of float64"),
        (np.zeros((8, 8, 3), np.uint8), r"in the shape \(8, 8, 3\); expected \(1, H, W, 3\)"),
        (np.zeros((2, 8, 8, 3), np.uint8), r"in the shape \(2, 8, 8, 3\)"),
        (np.zeros((1, 0, 8, 3), np.uint8), r"in the shape \(1, 0, 8, 3\)"),
    ],
    ids=["none", "list", "float", "bare", "two", "empty"],
)
def test_pictures_that_are_none_are_told(picture: Any, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fast, "render", lambda self, episodes, size: picture)
    with pytest.raises(UserError, match=f"^Fast is seen {told}.*: mend the simulator$"):
        check_filmable(Fast(1), "tall", "goal_3", 3, SIZE)


@pytest.mark.parametrize("channels", [1, 2, 4])
def test_grey_and_transparent_pictures_become_coloured(channels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = np.arange(6 * channels, dtype=np.uint8).reshape(1, 2, 3, channels)
    monkeypatch.setattr(Fast, "render", lambda self, episodes, size: picture)
    (frame, _) = replay(Fast(1), "goal_3", 3, ACTIONS[:1], SIZE).frames
    np.testing.assert_array_equal(frame, picture[0, ..., :3] if channels == 4 else picture[0][..., [0, 0, 0]])


def test_pictures_that_change_their_size_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fast, "hertz", 10.0)
    monkeypatch.setattr(Fast, "render", lambda self, episodes, size: np.zeros((1, 4 + self.t, 4, 3), np.uint8))
    with pytest.raises(UserError, match=r"Fast is seen in the shape \(5, 4, 3\); expected \(4, 4, 3\)"):
        replay(Fast(1), "goal_3", 3, ACTIONS, SIZE)


@pytest.mark.parametrize("deed", ["reset", "step", "render"])
def test_a_simulator_that_raises_is_to_blame(deed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("no\nway")

    monkeypatch.setattr(Fast, deed, fails)
    with pytest.raises(SimulatorError, match=r"Fast raised ValueError at test_replay.py:.*: no way"):
        replay(Fast(1), "goal_3", 3, ACTIONS, SIZE)


def test_another_signature_is_to_blame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fast, "render", lambda self: None)
    with pytest.raises(SimulatorError, match=r"Fast raised TypeError at replay.py:.*: .*positional argument"):
        check_filmable(Fast(1), "tall", "goal_3", 3, SIZE)


def test_missing_opengl_is_told_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def draws_nothing(*_: object) -> None:
        raise UserError(backend.missing("egl"))

    monkeypatch.setattr(Fast, "render", draws_nothing)
    with pytest.raises(
        UserError, match=r"images cannot be drawn: egl does not work on this machine; .*apt-get install"
    ):
        check_filmable(Fast(1), "tall", "goal_3", 3, SIZE)


@pytest.mark.parametrize("named", ["", "osmesa", "egl", "glfw"])
def test_a_machine_without_opengl_is_told_before_mujoco_is_imported(
    named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def imports(*_: object) -> None:
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    monkeypatch.setenv("MUJOCO_GL", named)
    monkeypatch.setattr(backend, "works", lambda backend: False)
    monkeypatch.setattr(PointMaze, "reset", imports)
    told = (
        "MUJOCO_GL is 'glfw'; expected egl or osmesa" if named == "glfw" else f"{named or 'egl'} does not work on this"
    )
    with pytest.raises(UserError, match=told):
        check_filmable(PointMaze("umaze"), "point", "s0_g_1_1", 3, SIZE)
