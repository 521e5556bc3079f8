"""Train the gait of a walker with PPO; ``plp collect --train_expert`` calls it.

Needs the extra ``experts`` (stable-baselines3). A quarter of an hour on one core for three million steps.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from safetensors.numpy import save_file
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from plp_lightning.envs.experts.plane import HORIZON, WalkingOnPlane

NOISE = (0.5, 0.08)  # largest standard deviation of the torques' exploration noise, at the beginning and at the end
COARSE = 0.8  # share of the training with Euler's integrator, a third of the cost of the mazes' Runge-Kutta

Progress = Callable[[int, str], object]
"""Told after each rollout how many more steps are done, and how well the walkers walk."""


class _Schedule(BaseCallback):
    """Lowers the noise and changes the integrator in time; reports, and writes the gait now and then."""

    def __init__(
        self, plane: WalkingOnPlane, steps: int, save: Callable[[], None], every: int, progress: Progress
    ) -> None:
        super().__init__()
        self._plane, self._steps, self._save, self._every, self._progress = plane, steps, save, every, progress
        self._lengths: list[int] = []
        self._rewards: list[float] = []
        self._next, self._told = every, 0

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
        self.model.policy.get_parameter("log_std").data.clamp_(
            max=float(np.log(first + min(progress, 1) * (last - first)))
        )

    def _on_rollout_end(self) -> None:
        done = min(self.num_timesteps, self._steps)
        lasted = np.mean(self._lengths or [HORIZON])
        note = f"reward {np.mean(self._rewards):.2f} a step, on their feet for {lasted:.0f} of {HORIZON} steps"
        self._progress(done - self._told, note)
        self._told, self._lengths, self._rewards = done, [], []
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            self._save()


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
    legs: int,
    out: Path,
    command: str,
    progress: Progress,
    steps: int = 3_000_000,
    seed: int = 0,
    walkers: int = 32,
    every: int = 100_000,
) -> None:
    """Train a direction-conditioned gait and write it.

    Args:
        legs: Legs of the body: 4 is the ant, 6 the spider.
        out: File of the gait; its provenance goes beside it as JSON.
        command: Command that the user typed, for the provenance.
        progress: Told after each rollout.
        steps: Control steps to train for; the last rollout is finished.
        seed: Seeds the network and the walks.
        walkers: Walkers simulated at once.
        every: Steps between gaits that are written on the way, for the case that training is stopped.
    """
    torch.set_num_threads(1)
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
    packages = ("mujoco", "stable_baselines3", "torch", "numpy")
    versions = {"python": platform.python_version(), **{name: version(name) for name in packages}}
    record = {"command": command, "legs": legs, "seed": seed, "walkers": walkers, "versions": versions}

    def save() -> None:
        save_gait(model.policy, env, out, {**record, "steps": model.num_timesteps, "of": steps})

    model.learn(steps, callback=_Schedule(plane, steps, save, every, progress))
    save()
