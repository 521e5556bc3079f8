"""One reset and one step of a new environment: what is none of Gymnasium's is told before anything is trained."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from datamodules.errors import ConfigError, UserError
from datamodules.types import Observation, ObservationKey
from plp_lightning.envs.gym.share import GymFactory

RESET = "reset(seed=…, options=…) that gives an observation and an info"
STEP = "step(action) that gives an observation, a reward, terminated, truncated and an info"


def try_out(factory: GymFactory, env: Any, task: str, keys: tuple[ObservationKey, ...], actions: int) -> None:
    """Begin an episode of a task in an environment, and take the middle action.

    Args:
        factory: Made the environment.
        env: The environment.
        task: Name of the task.
        keys: What the environment's observation space promises to show.
        actions: Size of an action.

    Raises:
        ConfigError: If the environment fails, or shows something else.
    """
    share = factory.share()
    share.free[task].append(env)
    with _telling(factory.env, RESET):
        seen = share.reset([task], [0])
    _check(factory.env, seen, keys, RESET)
    with _telling(factory.env, STEP):
        seen = share.step(np.zeros((1, actions)), np.arange(1)).observation
    _check(factory.env, seen, keys, STEP)


@contextmanager
def _telling(env: str, expected: str) -> Iterator[None]:
    try:
        yield
    except UserError:
        raise
    except Exception as error:  # an environment of others may raise anything
        told = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise ConfigError(f"environment {env!r} raised {told}; expected a {expected}: mend or wrap it") from error


def _check(env: str, seen: Observation[np.ndarray], keys: tuple[ObservationKey, ...], expected: str) -> None:
    numbers = sum(key.shape[0] for key in keys if key.kind == "state")
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {"state": (seen.state.shape[1:], (numbers,))}
    shapes |= {key.name: (seen.images[key.name].shape[1:], key.shape) for key in keys if key.kind == "image"}
    for name, (found, promised) in shapes.items():
        if found != promised:
            told = f"environment {env!r} shows {name} of shape {found}, and its observation_space says {promised}"
            raise ConfigError(f"{told}; expected a {expected}: mend or wrap it")
