"""A figure where people look for it: as an image in TensorBoard, and as a PNG beside the curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

from datamodules.atomic import locked_folder, replacing

DPI = 120


def publish(trainer: Trainer, name: str, figure: Figure) -> None:
    """Show a figure as image ``name`` in TensorBoard and leave ``<name>.png``, complete or absent, beside its events.

    Args:
        trainer: Whose loggers and step to use; without a TensorBoardLogger nothing happens.
        name: What it shows, in a word.
        figure: The figure.
    """
    figure.set_dpi(DPI)
    image = pixels(figure)
    for logger in trainer.loggers:
        if isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(name, image, trainer.global_step, dataformats="HWC")
            folder = Path(logger.log_dir)
            with locked_folder(folder), replacing(folder / f"{name}.png") as temporary:
                imsave(temporary, image, format="png")


def pixels(figure: Figure) -> np.ndarray:
    """RGB image ``(H, W, 3)`` uint8 of a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
