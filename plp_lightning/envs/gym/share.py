"""A share of the episodes of a simulator, each in an environment of its own, stepped one after the other."""

from __future__ import annotations

import contextlib
import importlib
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from datamodules.errors import ConfigError, UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Step
from plp_lightning.envs.gym.models import compiled_once
from plp_lightning.envs.gym.spaces import ActionRange, Leaf, find_leaves, gather_images, gather_states
from plp_lightning.envs.rendering.backend import choose_backend


@dataclass(frozen=True)
class GymFactory:
    """All that it takes to make environments and to read what they show; plain data, for other processes."""

    env: str
    make: Mapping[str, Any]
    tasks: Mapping[str, Mapping[str, Mapping[str, Any]]]  # arguments to make and reset by, by task
    success: str | float | None
    keys: tuple[str, ...] | None

    def share(self) -> Share:
        """Episodes of one process."""
        return Share(self)

    def build(self, task: str) -> Any:
        """A new environment for a task.

        Raises:
            ConfigError: If Gymnasium makes none of these words.
        """
        with contextlib.suppress(UserError):  # before MuJoCo is imported; without OpenGL nothing is drawn
            choose_backend()
        import gymnasium

        with warnings.catch_warnings():  # what Gymnasium warns of are the author's own matters
            warnings.filterwarnings("ignore", module=r"gymnasium\b")
            return self._made(gymnasium, {**self.make, **self.tasks[task].get("make", {})})

    def _made(self, gymnasium: Any, words: Mapping[str, Any]) -> Any:
        module, _, name = self.env.rpartition(":")
        try:
            factory = getattr(importlib.import_module(module), name, None) if module else None
            if factory is not None:
                return factory(**words)
            return _with_pictures(gymnasium, name, words)
        except (ImportError, TypeError, gymnasium.error.Error) as error:
            told = f"{f' of {words}' if words else ''}: {' '.join(str(error).split()).rstrip('.')}"
            unknown = isinstance(error, gymnasium.error.UnregisteredEnv) and not module
            remedy = f"name the package that registers it, as in my_package:{name}" if unknown else "mend env or make"
            raise ConfigError(f"environment {self.env!r} can't be made{told}; {remedy}") from error


def _with_pictures(gymnasium: Any, name: str, words: Mapping[str, Any]) -> Any:
    """Ask for an environment that can be drawn; one that can't is taken as it is."""
    if "render_mode" in words:
        return gymnasium.make(name, disable_env_checker=True, **words)
    try:
        return gymnasium.make(name, disable_env_checker=True, render_mode="rgb_array", **words)
    except (TypeError, gymnasium.error.Error):
        return gymnasium.make(name, disable_env_checker=True, **words)


class Share:
    """Episodes of one process.

    Environments are kept for later episodes of the same task: making one may cost more than an episode.

    Args:
        factory: Makes them.
    """

    def __init__(self, factory: GymFactory) -> None:
        self.factory = factory
        self.free: dict[str, list[Any]] = defaultdict(list)  # by task
        self.envs: list[tuple[str, Any]] = []  # of each episode, with its task
        self.last: list[Any] = []
        self.steps: list[Callable[[np.ndarray], Any]] = []  # of each episode, past what Gymnasium puts around it
        self.order = 1
        self.left, self.over = np.zeros(0), np.zeros(0, bool)  # steps until the environment's limit of time

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes; gives their first observations."""
        for task, env in self.envs:
            self.free[task].append(env)
        self.envs = [(task, self._env(task)) for task in tasks]
        self.steps, left = map(list, zip(*(_bare(env) for _, env in self.envs), strict=True))
        self.left, self.over = np.array(left), np.zeros(len(tasks), bool)
        self.last = [
            env.reset(seed=seed, options=dict(self.factory.tasks[task].get("reset", {})) or None)[0]
            for (task, env), seed in zip(self.envs, seeds, strict=True)
        ]
        return self._observed(range(len(tasks)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step with actions ``(n, A)`` in the episodes ``(n,)``; those that are over stay as they are."""
        invalid = ~np.isfinite(actions).all(axis=1)
        # To and fro, as environments that were stepped last are still in the processor's cache.
        self.order = -self.order
        rows = np.flatnonzero(~invalid & ~self.over[episodes])[:: self.order]
        moved, solved = episodes[rows], np.zeros(len(episodes), bool)
        solved[rows] = self._step(self._actions.own(actions[rows]), moved.tolist())
        self.left[moved] -= 1
        self.over[moved] |= self.left[moved] <= 0
        return Step(self._observed(episodes.tolist()), solved, invalid, self.over[episodes])

    def render(self, episodes: np.ndarray) -> list[np.ndarray]:
        """Pictures ``(H, W, 3)`` of the episodes ``(n,)``, of the environments' own size."""
        pictures = [self.envs[i][1].render() for i in episodes]
        if any(picture is None for picture in pictures):
            raise ConfigError(f"environment {self.factory.env!r} draws nothing; expected render_mode 'rgb_array'")
        return [np.asarray(picture, np.uint8) for picture in pictures]

    def _env(self, task: str) -> Any:
        if self.free[task]:
            return self.free[task].pop()
        with compiled_once():
            return self.factory.build(task)

    def _step(self, actions: np.ndarray, episodes: Sequence[int]) -> list[bool]:
        """Take a step of its own in each episode; tells which are solved."""
        solved = []
        for action, episode in zip(actions, episodes, strict=True):
            self.last[episode], reward, terminated, truncated, info = self.steps[episode](action)
            if terminated or truncated:
                self.over[episode] = True
            solved.append(self._solved(reward, terminated, info))
        return solved

    def _solved(self, reward: Any, terminated: Any, info: Mapping[str, Any]) -> bool:
        wanted = self.factory.success
        if wanted is None:
            return bool(info.get("is_success", info.get("success", terminated)))
        if isinstance(wanted, float | int):
            return bool(float(reward) >= wanted)
        if wanted == "terminated":
            return bool(terminated)
        if wanted not in info:
            known = f"info has {', '.join(map(str, info)) or 'nothing'}"
            told = "expected a name there, 'terminated', or a number that the reward reaches"
            raise ConfigError(f"Gymnasium.success is {wanted!r}; {known}: {told}")
        return bool(info[wanted])

    def _observed(self, episodes: Iterable[int]) -> Observation[np.ndarray]:
        seen = [self.last[i] for i in episodes]
        return Observation(gather_states(self._leaves, seen), gather_images(self._leaves, seen))

    @cached_property
    def _leaves(self) -> tuple[Leaf, ...]:
        return find_leaves(self.envs[0][1].observation_space, self.factory.keys)

    @cached_property
    def _actions(self) -> ActionRange:
        return ActionRange.of(self.envs[0][1].action_space)


def _bare(env: Any) -> tuple[Callable[[np.ndarray], Any], float]:
    """An environment's step without the limit of time and the check of order around it, and that limit, steps.

    Those two take as long as all else that is done here beside the step.
    """
    from gymnasium.wrappers import OrderEnforcing, TimeLimit

    if type(env) is OrderEnforcing:
        return _bare(env.env)
    if type(env) is TimeLimit and env.spec and env.spec.max_episode_steps:
        step, limit = _bare(env.env)
        return step, min(limit, env.spec.max_episode_steps)
    return env.step, np.inf
