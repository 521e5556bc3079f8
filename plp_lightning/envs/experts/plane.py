"""A place for walkers to learn to walk: an empty plane, directions that change, and pushes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv

from plp_lightning.envs.experts.gait import Symmetry
from plp_lightning.envs.maze.physics import MazePhysics
from plp_lightning.envs.maze.walker_model import walker_mjcf

SUBSTEPS = 5  # physics steps of a control step
HORIZON = 500  # control steps of an episode
REDRAW = 1 / 80  # chance of a new direction and a push in each step
PUSHES = (0.4, 2.0)  # standard deviations of ordinary and of hard pushes, in m/s and rad/s
HARD = 0.2  # share of hard pushes: a walker that begins with a foot in a maze's wall is kicked as hard
SPEED = 2.0  # faster than this (m/s) earns nothing: walkers that run fall over when a clone errs


class WalkingOnPlane(VecEnv):  # type: ignore[misc, unused-ignore]  # Any without stable-baselines3
    """Walkers on an empty plane, each told a direction that changes now and then.

    The reward asks for speed along the direction, at most ``SPEED``, an upright torso that does not turn, and small,
    smooth torques. A walker that keeps its heading has few postures for each direction, which clones easily.

    Args:
        legs: Legs of the body.
        walkers: Number that walk at once.
        seed: Seeds postures, directions and pushes.
    """

    render_mode: str | None = None

    def __init__(self, legs: int, walkers: int, seed: int) -> None:
        self._physics = MazePhysics(walker_mjcf(legs), threads=1)
        self._dt, self._joints = SUBSTEPS * self._physics.model.opt.timestep, 2 * legs
        self._symmetry, self._rng = Symmetry(legs), np.random.default_rng(seed)
        self._physics.begin(walkers)
        self._rest = self._physics.states[0].copy()
        self._directions, self._torques = np.zeros((walkers, 2)), np.zeros((walkers, self._joints))
        self._age = np.zeros(walkers, dtype=int)
        features = Box(-np.inf, np.inf, (self._symmetry.features,), np.float32)
        super().__init__(walkers, features, Box(-1, 1, (self._joints,), np.float32))

    def integrate(self, integrator: mujoco.mjtIntegrator) -> None:
        """Change the integrator from the next step on."""
        self._physics.model.opt.integrator = integrator

    def reset(self) -> np.ndarray:
        """Begin all episodes, and return features ``(n, F)``."""
        self._begin(np.arange(self.num_envs))
        return self._features()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the torques ``(n, A)`` of the next step, for the turned bodies."""
        self._next_torques = self._symmetry.torques(np.clip(actions, -1, 1), self._symmetry.turns(self._directions))

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Features ``(n, F)``, rewards ``(n,)`` and ends ``(n,)`` of one step; walkers whose end it is begin again."""
        before = self._qpos[:, :2].copy()
        valid = self._physics.hold(np.arange(self.num_envs), self._next_torques, SUBSTEPS)
        rewards = self._rewards((self._qpos[:, :2] - before) / self._dt)
        self._torques = self._next_torques
        self._age += 1
        fallen = ~valid | self._fallen()
        done = fallen | (self._age >= HORIZON)
        self._disturb(np.flatnonzero(~done & (self._rng.random(self.num_envs) < REDRAW)))
        last = self._features()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos[i] = {"terminal_observation": last[i], "TimeLimit.truncated": not fallen[i], "length": self._age[i]}
        self._begin(np.flatnonzero(done))
        return self._features(), rewards.astype(np.float32), done, infos

    @property
    def _qpos(self) -> np.ndarray:
        return self._physics.states[:, self._physics.qpos]

    def _features(self) -> np.ndarray:
        return self._symmetry.turn(self._physics.states[:, self._physics.physical], self._directions)

    def _rewards(self, velocity: np.ndarray) -> np.ndarray:
        along = (velocity * self._directions).sum(axis=1)
        across = np.abs(velocity[:, 0] * self._directions[:, 1] - velocity[:, 1] * self._directions[:, 0])
        turned = 1 - self._qpos[:, 3] ** 2
        spin = (self._physics.states[:, self._physics.qvel][:, 3:6] ** 2).sum(axis=1)
        effort = (self._next_torques**2).mean(axis=1)
        jerk = ((self._next_torques - self._torques) ** 2).mean(axis=1)
        # The bonus for being on one's feet keeps rewards positive: otherwise to fall at once would pay.
        posture = 1.0 - 0.5 * turned - 0.005 * spin - 0.3 * effort - 0.05 * jerk
        rewards: np.ndarray = np.minimum(along, SPEED) - 0.3 * across + posture
        return rewards

    def _fallen(self) -> np.ndarray:
        qpos = self._qpos
        height, upright = qpos[:, 2], 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
        return (height < 0.25) | (height > 1.1) | (upright < 0)

    def _begin(self, rows: np.ndarray) -> None:
        if len(rows) == 0:
            return
        self._physics.states[rows] = self._rest
        joints = slice(self._physics.qpos.start + 7, self._physics.qpos.stop)
        self._physics.states[rows, joints] += self._rng.uniform(-0.1, 0.1, (len(rows), self._joints))
        self._age[rows] = 0
        self._torques[rows] = 0
        self._disturb(rows)

    def _disturb(self, rows: np.ndarray) -> None:
        """New directions, half of them along the axes, and a push."""
        angles, quarter = self._rng.uniform(0, 2 * np.pi, len(rows)), np.pi / 2
        angles = np.where(self._rng.random(len(rows)) < 0.5, np.round(angles / quarter) * quarter, angles)
        self._directions[rows] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ordinary, hard = PUSHES
        strength = np.where(self._rng.random((len(rows), 1)) < HARD, hard, ordinary)
        first = self._physics.qvel.start
        self._physics.states[rows, first : first + 6] += strength * self._rng.normal(0, 1, (len(rows), 6))

    def close(self) -> None:
        """Nothing to close."""

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """No wrappers."""
        return [False] * self.num_envs

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """There are no single environments to call."""
        raise NotImplementedError

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of the whole, for each walker."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """There are no single environments to change."""
        raise NotImplementedError
