"""Films of episodes: an observer that keeps the images of the first few; strips on paper, and moving pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.rollout import Episodes, Observer
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.movies import caption, framed
from plp_lightning.pictures.paths import FAILED, SOLVED

IMAGES = 8  # images in a strip: the first, the last, and others evenly between
TILE = 96  # least side of an image in a moving picture, pixels
EVERY = 2  # control steps from one frame of a moving picture to the next


class Film(NamedTuple):
    """One episode, from its first state to its last."""

    task: str
    success: bool
    images: np.ndarray  # (T + 1, H, W, 3) uint8


class FilmRecorder(Observer):
    """Keeps the images ``(T + 1, H, W, 3)`` of the newest episodes of a domain with a camera, the first of several.

    Args:
        most: Number of episodes that are filmed, the first ones; it bounds the memory that is taken.
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
        """``count`` of the films ``(T + 1, H, W, 3)``, failures first; fewer if there are not as many."""
        known = zip(self._tasks, self._success, self._images, strict=False)
        found = [Film(task, bool(success), np.stack(images)) for task, success, images in known]
        return sorted(found, key=lambda film: film.success)[:count]

    def _keep(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> None:
        first = next(iter(observation.images.values()))  # of several cameras
        for episode, image in zip(episodes, first, strict=True):
            if episode < len(self._images):
                coloured = image[..., :3] if image.shape[-1] >= 3 else np.broadcast_to(image, (*image.shape[:2], 3))
                self._images[episode].append(coloured.copy())


def film_recorders(
    simulators: Mapping[str, Simulator], trials: Mapping[str, EvalSetting], most: int
) -> dict[str, FilmRecorder]:
    """A recorder of the first ``most`` episodes for each trial, by its name, whose domain has a camera."""
    specs = {name: simulators[trial.domain].spec(trial.domain) for name, trial in trials.items()}
    return {name: FilmRecorder(most) for name, spec in specs.items() if spec.image_keys and most > 0}


def film_figure(reels: Mapping[str, Sequence[Film]]) -> Figure:
    """One column of strips ``(H, W', 3)`` for each reel, a row for each film, at its left its task and end."""
    rows = max(map(len, reels.values()))
    figure = Figure(figsize=(IMAGES * len(reels), rows + 0.6), layout="constrained")
    columns = figure.subplots(rows, len(reels), squeeze=False).T
    for column, (title, films) in zip(columns, reels.items(), strict=True):
        column[0].set_title(title, fontsize=12)
        for axes, film in zip(column, films, strict=False):
            _draw_strip(axes, film)
        for axes in column[len(films) :]:
            axes.axis("off")
    return figure


def strip(film: Film) -> np.ndarray:
    """``IMAGES`` of a film side by side, first to last, with a white gap: ``(H, W', 3)`` uint8."""
    times = np.linspace(0, len(film.images) - 1, IMAGES).round().astype(int)
    gap = np.full((film.images.shape[1], 1, 3), 255, dtype=np.uint8)
    parts = [part for image in film.images[times] for part in (image, gap)]
    return np.concatenate(parts[:-1], axis=1)


def film_frames(reels: Mapping[str, Sequence[Film]]) -> list[np.ndarray]:
    """Frames of a moving picture of all films together: a row for each reel, its title above.

    Shorter films wait at their last image. A frame around each tells its end: blue solved, vermilion failed.

    Args:
        reels: By title: films in the order in which they are shown; images of all have one shape ``(H, W, 3)``.

    Returns:
        Frames ``(H', W', 3)`` uint8.
    """
    width = max(map(len, reels.values()))
    longest = max(len(film.images) for films in reels.values() for film in films)
    captions = {title: caption(title, width * _tile(films[0], 0).shape[1]) for title, films in reels.items()}
    times = [*range(0, longest - 1, EVERY), longest - 1]
    return [np.concatenate([*_rows(reels, captions, width, t)]) for t in times]


def _rows(
    reels: Mapping[str, Sequence[Film]], captions: Mapping[str, np.ndarray], width: int, t: int
) -> Iterator[np.ndarray]:
    for title, films in reels.items():
        yield captions[title]
        tiles = [_tile(film, t) for film in films]
        yield np.concatenate([*tiles, *[np.full_like(tiles[0], 255)] * (width - len(tiles))], axis=1)


def _tile(film: Film, t: int) -> np.ndarray:
    return framed(film.images[min(t, len(film.images) - 1)], TILE, _colour(film))


def _draw_strip(axes: Axes, film: Film) -> None:
    axes.imshow(strip(film))
    axes.set(xticks=[], yticks=[])
    for edge in axes.spines.values():
        edge.set(color=_colour(film), linewidth=2)
    text = f"{film.task}\n{'solved' if film.success else 'failed'}\n{len(film.images) - 1} steps"
    axes.set_ylabel(text, rotation=0, ha="right", va="center", fontsize=9, color=_colour(film))


def _colour(film: Film) -> tuple[float, float, float]:
    return to_rgb(SOLVED if film.success else FAILED)
