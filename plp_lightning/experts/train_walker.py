"""Train the gait of a walker with PPO: ``python -m plp_lightning.experts.train_walker --legs 4``.

Needs the extra ``experts`` (stable-baselines3). About twenty minutes on one core for three million steps.
"""

from __future__ import annotations

import json
import platform
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from gymnasium.spaces import Box
from safetensors.numpy import save_file
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import nn

from plp_lightning.envs.maze_rollout import BatchedPhysics
from plp_lightning.envs.walker_model import walker_mjcf
from plp_lightning.experts.gait import Symmetry, gait_path

HORIZON = 500
REDRAW = 1 / 80
"""Chance of a new direction and a push in each step."""
SPEED = 2.0
"""Faster than this (m/s) earns nothing: walkers that run fall over when a clone errs."""
NOISE = (0.5, 0.08)
"""Largest standard deviation of the torques' exploration noise, at the beginning and at the end."""
COARSE = 0.8
"""Share of the training with Euler's integrator, a third of the cost of the mazes' Runge-Kutta."""


class WalkingOnPlane(VecEnv):
    """Walkers on an empty plane, each told a direction that changes now and then.

    The reward asks for speed along the direction, at most ``SPEED``, an upright torso that does not turn, and small,
    smooth torques. A walker that keeps its heading has few postures for each direction, which clones easily.

    Args:
        legs: Legs of the body.
        walkers: How many walk at once.
        seed: Seeds postures, directions and pushes.
    """

    def __init__(self, legs: int, walkers: int, seed: int) -> None:
        model = mujoco.MjModel.from_xml_string(walker_mjcf(legs))
        self._model = model
        self._physics = BatchedPhysics(model, frame_skip=5, threads=1)
        self._dt = 5 * model.opt.timestep
        self._joints = model.nu
        self._symmetry = Symmetry(legs)
        self._rng = np.random.default_rng(seed)
        self._states = self._physics.initial_states(walkers)
        self._directions = np.zeros((walkers, 2))
        self._age = np.zeros(walkers, dtype=int)
        self._torques = np.zeros((walkers, model.nu))
        features = Box(-np.inf, np.inf, (self._symmetry.features,), np.float32)
        super().__init__(walkers, features, Box(-1, 1, (model.nu,), np.float32))

    def integrate(self, integrator: mujoco.mjtIntegrator) -> None:
        """Change the integrator from the next step on."""
        self._model.opt.integrator = integrator

    def reset(self) -> np.ndarray:
        """Begin all episodes; returns features ``(n, F)``."""
        self._begin(np.arange(self.num_envs))
        return self._features()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the torques of the next step, for the turned bodies."""
        self._next_torques = self._symmetry.torques(np.clip(actions, -1, 1), self._symmetry.turns(self._directions))

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Walk one control step; walkers that fell or ran out of time begin again."""
        before = self._states[:, self._physics.qpos][:, :2]
        self._states, valid = self._physics.step(self._states, self._next_torques)
        rewards = self._rewards((self._states[:, self._physics.qpos][:, :2] - before) / self._dt)
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

    def _features(self) -> np.ndarray:
        physical = np.concatenate([self._states[:, self._physics.qpos], self._states[:, self._physics.qvel]], axis=1)
        return self._symmetry.turn(physical, self._directions)

    def _rewards(self, velocity: np.ndarray) -> np.ndarray:
        along = (velocity * self._directions).sum(axis=1)
        across = np.abs(velocity[:, 0] * self._directions[:, 1] - velocity[:, 1] * self._directions[:, 0])
        turned = 1 - self._states[:, self._physics.qpos][:, 3] ** 2
        spin = (self._states[:, self._physics.qvel][:, 3:6] ** 2).sum(axis=1)
        effort = (self._next_torques**2).mean(axis=1)
        jerk = ((self._next_torques - self._torques) ** 2).mean(axis=1)
        # The bonus for being on one's feet keeps rewards positive: otherwise to fall at once would pay.
        posture = 1.0 - 0.5 * turned - 0.005 * spin - 0.3 * effort - 0.05 * jerk
        rewards: np.ndarray = np.minimum(along, SPEED) - 0.3 * across + posture
        return rewards

    def _fallen(self) -> np.ndarray:
        qpos = self._states[:, self._physics.qpos]
        height, upright = qpos[:, 2], 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
        return (height < 0.25) | (height > 1.1) | (upright < 0)

    def _begin(self, rows: np.ndarray) -> None:
        if len(rows) == 0:
            return
        states = self._physics.initial_states(len(rows))
        states[:, self._physics.qpos][:, 7:] += self._rng.uniform(-0.1, 0.1, (len(rows), self._joints))
        self._states[rows] = states
        self._age[rows] = 0
        self._torques[rows] = 0
        self._disturb(rows)

    def _disturb(self, rows: np.ndarray) -> None:
        """New directions, half of them along the axes, and a push."""
        angles = self._rng.uniform(0, 2 * np.pi, len(rows))
        quarter = np.pi / 2
        angles = np.where(self._rng.random(len(rows)) < 0.5, np.round(angles / quarter) * quarter, angles)
        self._directions[rows] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        first = self._physics.qvel.start
        self._states[rows, first : first + 6] += self._rng.normal(0, 0.4, (len(rows), 6))

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


class _Report(BaseCallback):
    """Prints a line and writes the gait now and then; lowers the noise and changes the integrator in time."""

    def __init__(self, plane: WalkingOnPlane, steps: int, out: Path, record: dict[str, object], every: int) -> None:
        super().__init__()
        self._plane, self._steps = plane, steps
        self._out, self._record, self._every = out, record, every
        self._lengths: list[int] = []
        self._rewards: list[float] = []
        self._next, self._start = 0, time.monotonic()

    def _on_step(self) -> bool:
        self._lengths += [info["length"] for info in self.locals["infos"] if "length" in info]
        vec = self.training_env
        assert isinstance(vec, VecNormalize)
        self._rewards.append(float(vec.get_original_reward().mean()))
        return True

    def _on_rollout_start(self) -> None:
        progress = self.num_timesteps / self._steps
        integrators = mujoco.mjtIntegrator
        self._plane.integrate(integrators.mjINT_EULER if progress < COARSE else integrators.mjINT_RK4)
        # With much noise to the end, the noise would hide postures in which the mean alone stands still for ever.
        first, last = NOISE
        self._log_std().data.clamp_(max=float(np.log(first + min(progress, 1) * (last - first))))

    def _on_rollout_end(self) -> None:
        if self.num_timesteps < self._next:
            return
        self._next = self.num_timesteps + self._every
        rate = self.num_timesteps / (time.monotonic() - self._start)
        length = np.mean(self._lengths or [HORIZON])
        print(
            f"{self.num_timesteps:>9} steps  {rate:6.0f}/s  reward {np.mean(self._rewards):5.2f} a step"
            f"  length {length:5.0f} of {HORIZON}  std {self._log_std().detach().exp().mean():.2f}",
            flush=True,
        )
        self._lengths, self._rewards = [], []
        vec = self.training_env
        assert isinstance(vec, VecNormalize)
        save_gait(self.model.policy, vec, self._out, {**self._record, "steps": self.num_timesteps})

    def _log_std(self) -> torch.Tensor:
        log_std: torch.Tensor = self.model.policy.get_parameter("log_std")
        return log_std


def save_gait(policy: Any, normalize: VecNormalize, out: Path, record: dict[str, object]) -> None:
    """Write the policy's mean network and the feature statistics to ``out``, the provenance beside it as JSON."""
    linear = [m for m in policy.mlp_extractor.policy_net if isinstance(m, nn.Linear)] + [policy.action_net]
    statistics: Any = normalize.obs_rms
    arrays = {
        "mean": statistics.mean.astype(np.float32),
        "scale": (1 / np.sqrt(statistics.var + normalize.epsilon)).astype(np.float32),
    }
    for i, layer in enumerate(linear):
        arrays[f"{i}.weight"] = layer.weight.detach().numpy()
        arrays[f"{i}.bias"] = layer.bias.detach().numpy()
    out.parent.mkdir(parents=True, exist_ok=True)
    save_file(arrays, out)
    out.with_suffix(".json").write_text(json.dumps(record, indent=2) + "\n")


def train_walker(
    legs: int = 4,
    steps: int = 3_000_000,
    seed: int = 0,
    out: Path | None = None,
    walkers: int = 32,
    every: int = 100_000,
) -> None:
    """Train a direction-conditioned gait and write it.

    Args:
        legs: Legs of the body: 4 is the ant, 6 the spider.
        steps: Control steps to train for.
        seed: Seeds the network and the walks.
        out: Where to write the gait; the package's own by default.
        walkers: Walkers simulated at once.
        every: Steps between lines of progress and saved gaits.
    """
    torch.set_num_threads(1)
    out = out or gait_path(legs)
    plane = WalkingOnPlane(legs, walkers, seed)
    env = VecNormalize(plane, gamma=0.99)
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=8192 // walkers,
        batch_size=1024,
        n_epochs=8,
        learning_rate=lambda left: 3e-4 * max(left, 0.1),
        target_kl=0.03,
        seed=seed,
        policy_kwargs={"net_arch": [128, 128], "activation_fn": nn.Tanh, "log_std_init": np.log(NOISE[0])},
        device="cpu",
    )
    record = _record(legs, steps, seed, walkers)
    model.learn(steps, callback=_Report(plane, steps, out, record, every))
    save_gait(model.policy, env, out, {**record, "steps": model.num_timesteps})


def _record(legs: int, steps: int, seed: int, walkers: int) -> dict[str, object]:
    options = {"legs": legs, "steps": steps, "seed": seed, "walkers": walkers}
    command = "python -m plp_lightning.experts.train_walker"
    packages = ("mujoco", "stable_baselines3", "torch", "numpy")
    versions = {"python": platform.python_version(), **{name: version(name) for name in packages}}
    return {
        "command": " ".join([command, *(f"--{name} {value}" for name, value in options.items())]),
        "legs": legs,
        "seed": seed,
        "versions": versions,
    }


if __name__ == "__main__":
    from jsonargparse import auto_cli

    auto_cli(train_walker, as_positional=False)
