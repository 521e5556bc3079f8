from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.figure import Figure
from matplotlib.image import imread
from PIL import Image, ImageSequence
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from plp_lightning.pictures.publish import DPI, pixels, publish, publish_film


def test_pixels_are_the_picture() -> None:
    figure = Figure(figsize=(2, 1), dpi=50, facecolor=(1, 0, 0))
    image = pixels(figure)
    assert image.shape == (50, 100, 3)
    assert image.dtype == np.uint8
    assert image[0, 0].tolist() == [255, 0, 0]


def test_a_figure_goes_to_tensorboard_and_beside_it_in_place_of_the_older_one(
    tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    folder = Path(logger.log_dir)
    folder.mkdir()
    (folder / "paths.png").write_bytes(b"old")
    publish(make_trainer(logger=logger), "paths", Figure(figsize=(2, 1), facecolor=(0, 0, 1)))
    logger.experiment.flush()
    image = imread(folder / "paths.png")
    assert image.shape[:2] == (DPI, 2 * DPI)
    assert image[0, 0, :3].tolist() == [0, 0, 1]
    events = EventAccumulator(str(folder))
    events.Reload()
    (shown,) = events.Images("alignment/paths")
    assert (shown.height, shown.width) == (DPI, 2 * DPI)
    assert [file.name for file in folder.iterdir() if "tfevents" not in file.name] == ["paths.png"]


def test_without_tensorboard_nothing_is_drawn(tmp_path: Path, make_trainer: Callable[..., Trainer]) -> None:
    publish(make_trainer(), "paths", Figure())
    publish_film(make_trainer(), "film", [np.zeros((4, 4, 3), np.uint8)])
    assert not list(tmp_path.iterdir())


def test_a_film_is_left_as_gif_with_all_its_frames(tmp_path: Path, make_trainer: Callable[..., Trainer]) -> None:
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    frames = [np.full((6, 8, 3), colour, np.uint8) for colour in ((200, 0, 0), (0, 200, 0))] * 2
    publish_film(make_trainer(logger=logger), "film", frames)
    with Image.open(Path(logger.log_dir) / "film.gif") as film:
        shown = [(np.asarray(frame.convert("RGB"))[0, 0].tolist(), frame.info["duration"]) for frame in _copies(film)]
    expected = [[200, 0, 0], [0, 200, 0], [200, 0, 0], [0, 200, 0]]
    assert shown == [*zip(expected, [50] * 3 + [1000], strict=True)]
    assert [file.name for file in Path(logger.log_dir).iterdir()] == ["film.gif"]


def _copies(film: Image.Image) -> list[Image.Image]:
    return [frame.copy() for frame in ImageSequence.Iterator(film)]
