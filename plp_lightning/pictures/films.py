"""Films of episodes: an observer that keeps the images of the first few."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.evaluation.simulation import EvalSetting


class Film(NamedTuple):
    """One episode, from its first state to its last."""

    task: str
    success: bool
    images: np.ndarray
    """``(T + 1, H, W, 3)`` uint8."""


class FilmRecorder(Observer):
    """Keeps the images of the newest episodes of a domain with a camera, as far as there is room.

    Args:
        most: Only so many episodes are filmed, the first ones; they bound the memory that is taken.
    """

    def __init__(self, most: int) -> None:
        self.most = most

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self._tasks, self._success = tuple(tasks), np.zeros(len(tasks), dtype=np.bool_)
        self._images: list[list[np.ndarray]] = [[] for _ in self._tasks[: self.most]]
        self._keep(observation, np.arange(len(tasks)))

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        self._keep(step.observation, episodes)

    def end(self, outcome: Episodes) -> None:
        self._success = outcome.success

    def films(self, count: int) -> list[Film]:
        """``count`` of the filmed episodes, failures first; fewer if there are not as many."""
        found = [
            Film(task, bool(success), np.stack(images))
            for task, success, images in zip(self._tasks, self._success, self._images, strict=False)
        ]
        return sorted(found, key=lambda film: film.success)[:count]

    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        assert observation.image is not None, "expected a simulator with a camera"
        for episode, image in zip(episodes, observation.image, strict=True):
            if episode < len(self._images):
                self._images[episode].append(image.copy())


def film_recorders(
    simulators: Mapping[str, Simulator], trials: Mapping[str, EvalSetting], most: int
) -> dict[str, FilmRecorder]:
    """A recorder for each trial, by its name, whose domain has a camera.

    Args:
        simulators: By domain.
        trials: By name.
        most: Episodes of each trial that are filmed; without any there are no recorders.
    """
    seen = [name for name, trial in trials.items() if _has_camera(simulators[trial.domain], trial.domain)]
    return {name: FilmRecorder(most) for name in seen if most > 0}


def _has_camera(simulator: Simulator, domain: str) -> bool:
    return simulator.spec(domain).image_key is not None
