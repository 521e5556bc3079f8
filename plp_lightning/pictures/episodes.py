"""Pictures of the target task's episodes at the end of a phase: paths through mazes, films by cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lightning.pytorch import Trainer

from plp_lightning.envs.base import Simulator
from plp_lightning.envs.rollout import Observer
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.films import FilmRecorder, film_figure, film_frames, film_recorders
from plp_lightning.pictures.paths import Panel, PathRecorder, path_figure, path_recorders
from plp_lightning.pictures.publish import publish, publish_film

FILMED = 4  # episodes that are filmed for each that is shown, so that there are failures to show


@dataclass(frozen=True)
class EpisodePictures:
    """Watches the episodes of the target task, and shows them; all is by trial."""

    titles: Mapping[str, str]
    paths: Mapping[str, PathRecorder]  # where there is a floor plan
    films: Mapping[str, FilmRecorder]  # where there is a camera
    shown: int  # films of each trial that are shown

    @classmethod
    def of(
        cls, simulators: Mapping[str, Simulator], settings: Mapping[str, EvalSetting], target_task: str, shown: int
    ) -> EpisodePictures:
        """Recorders for the settings ``target`` and ``source``, as far as there is something to see."""
        watched = {name: setting for name, setting in settings.items() if name in ("target", "source")}
        titles = {name: f"{target_task} in {name} domain: {setting.domain}" for name, setting in watched.items()}
        paths = path_recorders(simulators, watched)
        return cls(titles, paths, film_recorders(simulators, watched, FILMED * shown), shown)

    @property
    def observers(self) -> dict[str, list[Observer]]:
        """The recorders by trial."""
        recorders: list[Mapping[str, Observer]] = [self.paths, self.films]
        return {name: [found[name] for found in recorders if name in found] for name in self.titles}

    def publish(self, trainer: Trainer) -> None:
        """Show the episodes: ``paths`` and ``film`` in TensorBoard, as PNG, and the film as GIF."""
        if self.paths:
            panels = [Panel(self.titles[name], found.plan, found.paths) for name, found in self.paths.items()]
            publish(trainer, "paths", path_figure(panels))
        if self.films:
            reels = {self.titles[name]: recorder.films(self.shown) for name, recorder in self.films.items()}
            publish(trainer, "film", film_figure(reels))
            publish_film(trainer, "film", film_frames(reels))
