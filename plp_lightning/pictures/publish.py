"""Figures as images in TensorBoard, and as PNG files beside the curves; films as GIF files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

from datamodules.store.atomic import locked_folder, replacing
from plp_lightning.pictures.movies import write_gif

DPI = 120
RATE = 20.0  # frames of a moving picture in a second


@runtime_checkable
class Counting(Protocol):
    """A logger that counts steps on over the phases of a run."""

    def step_of_run(self, step: int) -> int:
        """Step of the run at a step of the phase."""


def publish(trainer: Trainer, name: str, figure: Figure) -> None:
    """Show a figure as image ``<phase>/<name>`` in TensorBoard and leave ``<name>.png``, complete or absent, beside.

    Without a TensorBoardLogger of the trainer's nothing happens.
    """
    figure.set_dpi(DPI)
    image = pixels(figure)
    for logger in _tensorboards(trainer):
        step = trainer.global_step
        step = logger.step_of_run(step) if isinstance(logger, Counting) else step
        logger.experiment.add_image(f"{logger.name}/{name}", image, step, dataformats="HWC")
        folder = Path(logger.log_dir)
        with locked_folder(folder), replacing(folder / f"{name}.png") as temporary:
            imsave(temporary, image, format="png")


def publish_film(trainer: Trainer, name: str, frames: Sequence[np.ndarray]) -> None:
    """Leave a moving picture ``<name>.gif``, complete or absent, beside TensorBoard's events.

    Args:
        trainer: Trainer with the loggers to use; without a TensorBoardLogger nothing happens.
        name: Name of the picture, in a word.
        frames: One or more images ``(H, W, 3)`` uint8, all of one shape; the last stays for a second.
    """
    for logger in _tensorboards(trainer):
        write_gif(Path(logger.log_dir) / f"{name}.gif", frames, RATE)


def pixels(figure: Figure) -> np.ndarray:
    """RGB image ``(H, W, 3)`` uint8 of a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _tensorboards(trainer: Trainer) -> list[TensorBoardLogger]:
    return [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
