"""A walking policy: joint torques that move a walker in a given direction, from its own state alone."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from datamodules.errors import CheckpointError

WEIGHTS = Path(__file__).parent / "weights"
TRAIN = "plp collect --config FILE --train_expert DOMAIN --weights FILE"  # the command that trains a gait
VELOCITY_LIMIT = 10.0  # velocities beyond this (m/s, rad/s) look the same to the gait


class Symmetry:
    """A walker with n equal legs looks the same when turned by 2 π / n and its legs are renumbered.

    A gait therefore need only learn to walk in directions within such an angle: states are turned until the direction
    lies there, and the torques for them are handed back to the legs they belong to. Joints and motors are in the order
    of :func:`plp_lightning.envs.maze.walker_model.walker_mjcf`.
    """

    def __init__(self, legs: int) -> None:
        self.legs, self.features, self._sector = legs, 13 + 4 * legs, 2 * np.pi / legs
        # Corridors run along the axes: none of those may lie where one turn gives way to the next.
        self._offset = 0.0 if legs % 4 == 0 else 0.25
        angles = (np.arange(legs) + 0.5) * self._sector
        # The ankles of the legs behind bend by negative angles.
        ankles = np.where(np.cos(angles) > -1e-9, 1.0, -1.0)
        self._signs = np.stack([np.ones(legs), ankles], axis=1)

    def turns(self, directions: np.ndarray) -> np.ndarray:
        """Number of n-ths of a full turn ``(m,)`` that bring directions ``(m, 2)`` back to where the gait walks."""
        angles = np.arctan2(directions[:, 1], directions[:, 0])
        turns: np.ndarray = np.rint(angles / self._sector - self._offset).astype(int)
        return turns

    def turn(self, states: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Features that the gait sees: everything but the walker's place, turned back by :meth:`turns`.

        Args:
            states: ``(m, 13 + 4 n)``: position xy, height, quaternion, joints, velocities.
            directions: ``(m, 2)`` unit vectors in the plane, in which to walk.

        Returns:
            ``(m, 13 + 4 n)`` float32: the turned states with xy replaced by the turned direction, at the end.
        """
        turns, joints = self.turns(directions), 2 * self.legs
        velocities = np.clip(states[:, 7 + joints :], -VELOCITY_LIMIT, VELOCITY_LIMIT)
        parts = (
            states[:, 2:4],
            self._rotate(states[:, 4:7], turns),
            self._renumber(states[:, 7 : 7 + joints], turns),
            self._rotate(velocities[:, :3], turns),
            self._rotate(velocities[:, 3:6], turns),
            self._renumber(velocities[:, 6:], turns),
            self._rotate(directions, turns),
        )
        turned: np.ndarray = np.concatenate(parts, axis=1).astype(np.float32)
        return turned

    def torques(self, actions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Motor torques ``(m, 2 n)`` of the body from those ``(m, 2 n)`` of the turned body, legs in order."""
        legs = (np.arange(self.legs) - turns[:, None]) % self.legs
        own = actions.reshape(-1, self.legs, 2)[np.arange(len(turns))[:, None], legs] * self._signs
        # The last leg's motors come first.
        return np.roll(own, 1, axis=1).reshape(len(turns), -1)

    def _rotate(self, vectors: np.ndarray, turns: np.ndarray) -> np.ndarray:
        cos, sin = np.cos(turns * self._sector), np.sin(turns * self._sector)
        x, y = vectors[:, 0], vectors[:, 1]
        return np.column_stack([cos * x + sin * y, cos * y - sin * x, vectors[:, 2:]])

    def _renumber(self, joints: np.ndarray, turns: np.ndarray) -> np.ndarray:
        legs = (np.arange(self.legs) + turns[:, None]) % self.legs
        signed = joints.reshape(-1, self.legs, 2) * self._signs
        renumbered: np.ndarray = signed[np.arange(len(turns))[:, None], legs].reshape(len(turns), -1)
        return renumbered


@dataclass(frozen=True)
class Gait:
    """A tanh network over normalised features; its weights are the mean of a PPO policy."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]  # weight (out, in) and bias (out,) of each, tanh between them
    mean: np.ndarray  # (F,) mean of the features
    scale: np.ndarray  # (F,) factor that normalises them

    @property
    def legs(self) -> int:
        """Legs of the body that it moves."""
        return len(self.layers[-1][1]) // 2

    def act(self, states: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Torques ``(m, 2 n)`` in [-1, 1] that walk from states ``(m, 13 + 4 n)`` in directions ``(m, 2)``."""
        symmetry = Symmetry(self.legs)
        hidden = np.clip((symmetry.turn(states, directions) - self.mean) * self.scale, -10.0, 10.0)
        for weight, bias in self.layers[:-1]:
            hidden = np.tanh(_row_by_row(hidden, weight) + bias)
        weight, bias = self.layers[-1]
        torques = np.clip(_row_by_row(hidden, weight) + bias, -1.0, 1.0)
        return symmetry.torques(torques, symmetry.turns(directions))

    @classmethod
    def load(cls, path: Path) -> Gait:
        """Read a gait that ``plp collect --train_expert`` wrote.

        Raises:
            CheckpointError: If there is no such file, it holds no gait, or the record beside it is missing or of
                another body.
        """
        if not path.is_file():
            raise CheckpointError(f"no gait at {path}; name another file or train one with: {TRAIN}")
        arrays = _read(path)
        count = sum(name.endswith(".weight") for name in arrays)
        try:
            layers = tuple((arrays[f"{i}.weight"], arrays[f"{i}.bias"]) for i in range(count))
            gait = cls(layers, arrays["mean"], arrays["scale"])
        except KeyError as error:
            raise CheckpointError(f"{path} is no gait: it lacks {error}; train it again") from error
        if flaw := gait.flaw:
            raise CheckpointError(f"{path} is no gait: {flaw}; train it again")
        if (told := provenance(path).get("legs")) != gait.legs:
            raise CheckpointError(f"{card_path(path)}: says {told!r} legs, but {path} moves {gait.legs}; take its own")
        return gait

    @property
    def flaw(self) -> str:
        """In a few words, why it can't move a body; empty if it can."""
        for name, array in (("mean", self.mean), ("scale", self.scale), *self._parameters()):
            if array.dtype != np.float32:
                return f"{name} is of type {array.dtype}, expected float32"
            if not np.isfinite(array).all():
                return f"{name} is not finite"
        torques = self.layers[-1][1].size if self.layers else 0
        if torques == 0 or torques % 2:
            return f"it gives {torques} torques, expected two a leg"
        return self._misfit(Symmetry(torques // 2).features)

    def _parameters(self) -> Iterator[tuple[str, np.ndarray]]:
        for i, (weight, bias) in enumerate(self.layers):
            yield from ((f"{i}.weight", weight), (f"{i}.bias", bias))

    def _misfit(self, features: int) -> str:
        """The first array whose shape doesn't fit those before it, for F ``features`` at the beginning."""
        expected: dict[str, tuple[int, ...]] = {"mean": (features,), "scale": (features,)}
        for i, (_, bias) in enumerate(self.layers):
            expected |= {f"{i}.weight": (bias.size, features), f"{i}.bias": (bias.size,)}
            features = bias.size
        for name, array in (("mean", self.mean), ("scale", self.scale), *self._parameters()):
            if array.shape != expected[name] or not array.size:
                return f"{name} is of shape {array.shape}, expected {expected[name]}"
        return ""


def _row_by_row(rows: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Products ``(m, out)`` of rows ``(m, in)`` with a weight ``(out, in)``, each as if it were alone.

    One product of all rows rounds by how many there are. A walker's steps grow apart from the last bit, so that an
    attempt at a demonstration would succeed or fail by who is beside it.
    """
    products: np.ndarray = (rows[:, None] @ weight.T)[:, 0]
    return products


def gait_path(legs: int) -> Path:
    """Path of the gait that comes with this package, for a body with ``legs`` legs."""
    return WEIGHTS / f"walker_{legs}.safetensors"


def card_path(path: Path) -> Path:
    """Path of the record that stands beside the gait at ``path``."""
    return path.with_suffix(".json")


def provenance(path: Path) -> dict[str, object]:
    """Command, seed, steps and versions that the gait at ``path`` was made with.

    Raises:
        CheckpointError: If the record beside it is missing or none.
    """
    card = card_path(path)
    try:
        record = json.loads(card.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{card}: cannot be read ({error}); expected JSON that {TRAIN} wrote") from None
    if not isinstance(record, dict):
        raise CheckpointError(f"{card}: holds no record; expected JSON that {TRAIN} wrote")
    return record


def _read(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a safetensors file, whose own reader raises many kinds of errors for what is none."""
    try:
        return load_file(path)
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"[:160]
        remedy = f"name another file or train one with: {TRAIN}"
        raise CheckpointError(f"{path}: not a safetensors file ({reason}); {remedy}") from None
