"""Any environment of Gymnasium (https://gymnasium.farama.org) as a simulator, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeInt, PositiveFloat, PositiveInt
from datamodules.types import DomainSpec, ObservationKey
from plp_lightning.envs.cores import available_processes
from plp_lightning.envs.gym.share import GymFactory
from plp_lightning.envs.gym.spaces import ActionRange, find_leaves
from plp_lightning.envs.gym.trial import try_out
from plp_lightning.envs.pool import Pool, PooledSimulator
from plp_lightning.envs.tasks import Tasks

Setup = dict[str, dict[str, Any]]
TASK_WORDS = ("make", "reset")


class Shown(NamedTuple):
    """Facts that one environment tells about all."""

    keys: tuple[ObservationKey, ...]
    actions: ActionRange
    control_hz: float


class Gymnasium(PooledSimulator):
    """Any environment of Gymnasium, by its name: each episode has one of its own, and processes step them on all cores.

    An episode begins by ``reset(seed=…, options=…)``. Actions in [-1, 1] are brought to the limits of the environment's
    own. An episode that the environment ends unsolved has failed. Whether an episode depends on its task, seed and
    actions alone is up to the environment.

    Args:
        env: Id of a registered environment, with the package that registers it before a colon, as in
            ``gymnasium_robotics:FetchReach-v4``; or a factory, ``my_package.arms:make_arm``.
        tasks: Tasks by name, each with the arguments that set it up: ``reset``, options of the reset, and ``make``,
            arguments of the constructor. Names alone stand for resets with the option ``task``.
        make: Arguments of the constructor for all tasks.
        success: When a step has solved the task: the name of a truth value in the step's ``info``; ``terminated``; or a
            number that the step's reward reaches. If not given, ``is_success`` or ``success`` in ``info``, and where
            there is neither, that the environment has terminated.
        keys: Keys of the observation that the policy sees, in order; all if not given.
        control_hz: Control steps in a second; the environment's ``dt`` or ``render_fps`` if not given.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Processes that step; 0 means one for each core, at most 16 or ``PLP_PROCESSES``.

    Raises:
        ConfigError: If a task is set up by other words, or there is none.
    """

    needs = ("gymnasium",)

    def __init__(
        self,
        env: str,
        tasks: list[str] | dict[str, Setup],
        make: dict[str, Any] | None = None,
        success: str | float | None = None,
        keys: list[str] | None = None,
        control_hz: PositiveFloat | None = None,
        horizon: PositiveInt = 200,
        threads: NonNegativeInt = 0,
    ) -> None:
        setups = _setups(tasks)
        self.factory = GymFactory(env, make or {}, setups, success, None if keys is None else tuple(keys))
        self.control_hz, self.horizon, self.threads = control_hz, horizon, threads
        self.imports = tuple(filter(None, [env.rpartition(":")[0]]))
        self._tasks = Tasks(env, tuple(tasks))

    def spec(self, name: str) -> DomainSpec:
        low, high = (tuple(map(float, limit)) for limit in (self._shown.actions.low, self._shown.actions.high))
        env = f"Gymnasium {self.factory.env}" + "".join(f", {k} {v}" for k, v in sorted(self.factory.make.items()))
        return DomainSpec(name, self._shown.keys, len(low), self._shown.control_hz, env, low, high)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` as the environment draws them, of its own size."""
        return self._pool.rows("render", episodes)

    @cached_property
    def _pool(self) -> Pool:
        return Pool(self.factory, self.threads or available_processes())

    @cached_property
    def _shown(self) -> Shown:
        task = self.tasks.names[0]
        env = self.factory.build(task)
        keys = tuple(leaf.key for leaf in find_leaves(env.observation_space, self.factory.keys))
        found = Shown(keys, ActionRange.of(env.action_space), self.control_hz or _control_hz(env))
        try_out(self.factory, env, task, keys, len(found.actions.low))
        env.close()
        return found


def _control_hz(env: Any) -> float:
    step = getattr(env.unwrapped, "dt", None)
    found = 1 / step if step else env.metadata.get("render_fps")
    if not found:
        raise ConfigError("the environment says neither dt nor render_fps; expected Gymnasium.control_hz: state it")
    return float(found)


def _setups(tasks: Sequence[str] | Mapping[str, Setup]) -> Mapping[str, Setup]:
    """Arguments that set up each task; refuses, by a :class:`ConfigError`, other words than :data:`TASK_WORDS`."""
    if not tasks:
        raise ConfigError("Gymnasium.tasks is empty; expected names, or reset and make arguments by name")
    if not isinstance(tasks, Mapping):
        return {name: {"reset": {"task": name}} for name in tasks}
    for name, words in tasks.items():
        for word in words or {}:
            if word not in TASK_WORDS:
                raise ConfigError(f"task {name!r} is set up by {word!r}; expected {' or '.join(TASK_WORDS)}")
    return {name: words or {} for name, words in tasks.items()}
