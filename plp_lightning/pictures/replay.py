"""Episodes that are run again to be looked at: as their simulator draws them, or as its camera sees them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datamodules.errors import ConfigError, UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import blaming
from plp_lightning.envs.rendering.backend import check_backend
from plp_lightning.envs.views import Rendered

RATE = 25.0  # frames per second that are enough
MOST = 800  # frames of a film; of a longer episode fewer are taken in a second
ONLY = np.zeros(1, dtype=np.int64)  # the episode, where one is run alone


class Played(NamedTuple):
    """A film of one episode, in real time."""

    frames: list[np.ndarray]  # (H, W, 3) uint8, all of one shape
    rate: float  # frames per second
    success: bool  # at the last step


def check_filmable(simulator: Simulator, domain: str, task: str, seed: int, size: tuple[int, int]) -> None:
    """Draw a first picture ``(H, W, 3)``, before minutes are spent on episodes.

    Raises:
        ConfigError: If the simulator neither renders nor has a camera.
        UserError: If pictures cannot be drawn on this machine, or are none.
    """
    if not isinstance(simulator, Rendered) and not simulator.spec(domain).image_keys:
        found = f"domain {domain!r} cannot be filmed: {type(simulator).__name__} neither renders nor has a camera"
        raise ConfigError(f"{found}; expected pictures: give it a method render(episodes, size)")
    if "mujoco" in simulator.needs:
        check_backend()  # before MuJoCo is imported, which fails where the library of MUJOCO_GL is missing
    with blaming(simulator):
        observation = simulator.reset([task], [seed])
    seen(simulator, observation, size)


def replay(simulator: Simulator, task: str, seed: int, actions: np.ndarray, size: tuple[int, int]) -> Played:
    """Run the episode of ``task`` and ``seed`` again, alone, by its actions ``(T, A)``.

    Args:
        simulator: The domain.
        task: Task of the episode.
        seed: Its seed.
        actions: Its actions.
        size: Height and width that pictures are asked for, pixels.

    Raises:
        SimulatorError: If the simulator raises.
        UserError: If pictures cannot be drawn on this machine, or are none.
    """
    hertz = simulator.spec("").control_hz
    every = max(1, round(hertz / RATE), math.ceil(len(actions) / MOST))
    with blaming(simulator):
        observation, success = simulator.reset([task], [seed]), np.zeros(1, dtype=np.bool_)
    frames = [seen(simulator, observation, size)]
    for t, action in enumerate(actions, 1):
        with blaming(simulator):
            observation, success = simulator.step(action[None], ONLY)[:2]
        if t % every == 0 or t == len(actions):
            frames.append(seen(simulator, observation, size))
            _check_shape(simulator, frames[-1].shape, frames[0].shape)
    return Played(frames, hertz / every, bool(success[0]))


def seen(
    simulator: Simulator, observation: Observation[np.ndarray], size: tuple[int, int], episode: np.ndarray = ONLY
) -> np.ndarray:
    """Picture ``(H, W, 3)`` of one episode ``(1,)``; grey becomes a colour, what is behind three channels is left.

    Args:
        simulator: The domain.
        observation: What is seen of that episode, ``(1, …)``.
        size: Height and width that are asked for, pixels.
        episode: Its number among those that run.

    Raises:
        UserError: If it cannot be drawn on this machine, or is no picture.
    """
    images: object = next(iter(observation.images.values()), None)  # the first camera's, of several
    if isinstance(simulator, Rendered):
        with blaming(simulator):
            images = simulator.render(episode, size)
    if not isinstance(images, np.ndarray) or images.dtype != np.uint8:
        given = f"an array of {images.dtype}" if isinstance(images, np.ndarray) else type(images).__name__
        raise UserError(
            f"{type(simulator).__name__} is seen as {given}; expected an array of uint8: mend the simulator"
        )
    if images.ndim != 4 or len(images) != 1 or 0 in images.shape:
        _check_shape(simulator, images.shape, ("1", "H", "W", "3"))
    seen = images[0, ..., :3] if images.shape[-1] >= 3 else images[0, ..., :1]
    return np.array(np.broadcast_to(seen, (*seen.shape[:2], 3)))


def _check_shape(simulator: Simulator, found: tuple[object, ...], wanted: tuple[object, ...]) -> None:
    if found != wanted:
        given, expected = (f"({', '.join(map(str, shape))})" for shape in (found, wanted))
        raise UserError(
            f"{type(simulator).__name__} is seen in the shape {given}; expected {expected}: mend the simulator"
        )
