"""Figures as images in TensorBoard, and as PNG files beside the curves; films as GIF files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from PIL import Image

from datamodules.store.atomic import locked_folder, replacing

DPI = 120
FRAME_TIME, LAST_FRAME_TIME = 50, 1000  # time that a frame of a moving picture stays, ms


def publish(trainer: Trainer, name: str, figure: Figure) -> None:
    """Show a figure as image ``name`` in TensorBoard and leave ``<name>.png``, complete or absent, beside its events.

    Without a TensorBoardLogger of the trainer's nothing happens.
    """
    figure.set_dpi(DPI)
    image = pixels(figure)
    for logger in _tensorboards(trainer):
        logger.experiment.add_image(name, image, trainer.global_step, dataformats="HWC")
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
    # One palette for all, from both ends: with one each, colours would flicker.
    palette = Image.fromarray(np.concatenate([frames[0], frames[-1]])).quantize(256)
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [FRAME_TIME] * (len(images) - 1) + [LAST_FRAME_TIME]
    for logger in _tensorboards(trainer):
        folder = Path(logger.log_dir)
        folder.mkdir(parents=True, exist_ok=True)
        with locked_folder(folder), replacing(folder / f"{name}.gif") as temporary:
            images[0].save(temporary, "GIF", save_all=True, append_images=images[1:], duration=times, loop=0)


def pixels(figure: Figure) -> np.ndarray:
    """RGB image ``(H, W, 3)`` uint8 of a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _tensorboards(trainer: Trainer) -> list[TensorBoardLogger]:
    return [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
