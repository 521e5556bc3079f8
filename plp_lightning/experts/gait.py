"""A walking policy: joint torques that move a walker in a given direction, from its own state alone."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from datamodules.errors import CheckpointError

WEIGHTS = Path(__file__).parent / "weights"
VELOCITY_LIMIT = 10.0
"""Velocities beyond this (m/s, rad/s) look the same to the gait."""


def gait_features(states: np.ndarray, joints: int, directions: np.ndarray) -> np.ndarray:
    """What the gait sees: everything but where the walker is.

    Args:
        states: ``(n, 13 + 2 joints)``: position xy, height, quaternion, joints, velocities.
        joints: Number of leg joints.
        directions: ``(n, 2)`` unit vectors in the plane: where to go.

    Returns:
        ``(n, 13 + 2 joints)`` float32: the states with xy replaced by the direction, at the end.
    """
    posture, velocities = states[:, 2 : 7 + joints], states[:, 7 + joints :]
    limited = np.clip(velocities, -VELOCITY_LIMIT, VELOCITY_LIMIT)
    features: np.ndarray = np.concatenate([posture, limited, directions], axis=1).astype(np.float32)
    return features


@dataclass(frozen=True)
class Gait:
    """A tanh network over normalised features; its weights are the mean of a PPO policy.

    Args:
        layers: ``(weight (out, in), bias (out,))`` of each layer, tanh between them.
        mean: ``(F,)`` mean of the features.
        scale: ``(F,)`` factor that normalises them.
    """

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    mean: np.ndarray
    scale: np.ndarray

    @property
    def torques(self) -> int:
        """A, the number of joints it moves."""
        return len(self.layers[-1][1])

    def act(self, features: np.ndarray) -> np.ndarray:
        """Torques ``(n, A)`` in [-1, 1] for features ``(n, F)``."""
        hidden = np.clip((features - self.mean) * self.scale, -10.0, 10.0)
        *inner, (weight, bias) = self.layers
        for inner_weight, inner_bias in inner:
            hidden = np.tanh(hidden @ inner_weight.T + inner_bias)
        actions: np.ndarray = np.clip(hidden @ weight.T + bias, -1.0, 1.0)
        return actions

    @classmethod
    def load(cls, path: Path) -> Gait:
        """Read a gait that ``plp_lightning.experts.train_walker`` wrote.

        Raises:
            CheckpointError: If there is no such file or it holds no gait.
        """
        if not path.is_file():
            raise CheckpointError(
                f"no gait at {path}; train one with: python -m plp_lightning.experts.train_walker --help"
            )
        arrays = load_file(path)
        count = sum(name.endswith(".weight") for name in arrays)
        try:
            layers = tuple((arrays[f"{i}.weight"], arrays[f"{i}.bias"]) for i in range(count))
            return cls(layers, arrays["mean"], arrays["scale"])
        except KeyError as error:
            raise CheckpointError(f"{path} is no gait: it lacks {error}; train it again") from error


def gait_path(legs: int) -> Path:
    """Where the gait that comes with this package lies, for a body with ``legs`` legs."""
    return WEIGHTS / f"walker_{legs}.safetensors"


def provenance(path: Path) -> dict[str, object]:
    """How the gait at ``path`` was made: command, seed, steps, versions."""
    record: dict[str, object] = json.loads(path.with_suffix(".json").read_text())
    return record
