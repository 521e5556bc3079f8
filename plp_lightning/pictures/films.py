"""What the cameras saw of episodes: a simulator that keeps the images of the first few."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.recorder import Recorder


class Film(NamedTuple):
    """One episode, from its first state to its last."""

    task: str
    success: bool
    images: np.ndarray
    """``(T + 1, H, W, 3)`` uint8."""


class FilmRecorder(Recorder):
    """Stands in for a simulator with a camera and keeps the images of its newest episodes, as far as there is room.

    Args:
        simulator: Who simulates.
        most: Only so many episodes are filmed, the first ones; they bound the memory that is taken.
    """

    def __init__(self, simulator: Simulator, most: int) -> None:
        super().__init__(simulator)
        self.most = most

    def films(self, count: int) -> list[Film]:
        """``count`` of the filmed episodes since the last reset, failures first; fewer if there are not as many."""
        found = [
            Film(task, bool(success), np.stack(images))
            for task, success, images in zip(self._tasks, self._success, self._images, strict=False)
        ]
        return sorted(found, key=lambda film: film.success)[:count]

    def _forget(self) -> None:
        self._images: list[list[np.ndarray]] = [[] for _ in self._tasks[: self.most]]

    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        assert observation.image is not None, "expected a simulator with a camera"
        for episode, image in zip(episodes, observation.image, strict=True):
            if episode < len(self._images):
                self._images[episode].append(image.copy())


def film_recorders(
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    most: int,
    stages: Mapping[str, Simulator] | None = None,
) -> dict[str, FilmRecorder]:
    """A recorder for each trial, by its name, whose domain has a camera.

    Args:
        simulators: By domain.
        trials: By name.
        most: Episodes of each trial that are filmed; without any there are no recorders.
        stages: By trial: recorders that watch these episodes as well.
    """
    seen = {name: trial for name, trial in trials.items() if _has_camera(simulators[trial.domain], trial.domain)}
    watched = {name: simulators[trial.domain] for name, trial in seen.items()} | dict(stages or {})
    return {name: FilmRecorder(watched[name], most) for name in seen if most > 0}


def _has_camera(simulator: Simulator, domain: str) -> bool:
    return simulator.spec(domain).image_key is not None
