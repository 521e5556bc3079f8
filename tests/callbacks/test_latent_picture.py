from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.figure import Figure

from plp_lightning.callbacks.latent_picture import LatentPicture, latent_figure, pixels
from plp_lightning.phases import Alignment


def test_every_domain_has_its_points_and_its_colour() -> None:
    rng = np.random.default_rng(0)
    figure = latent_figure({"flat": rng.normal(size=(12, 4)), "tall": rng.normal(5, 1, (9, 4))})
    (axes,) = figure.axes
    assert [len(points.get_offsets()) for points in axes.collections] == [12, 9]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["flat", "tall"]
    colours = {tuple(points.get_facecolor()[0]) for points in axes.collections}
    assert len(colours) == 2


def test_pixels_are_the_picture() -> None:
    figure = Figure(figsize=(2, 1), dpi=50, facecolor=(1, 0, 0))
    image = pixels(figure)
    assert image.shape == (50, 100, 3)
    assert image.dtype == np.uint8
    assert image[0, 0].tolist() == [255, 0, 0]


@pytest.mark.parametrize(("every", "epochs"), [(0, [4]), (2, [2, 4]), (3, [3, 4])])
def test_pictures_are_drawn_in_their_epochs_and_at_the_end(
    trajectory_file: Path,
    make_trainer: Callable[..., Trainer],
    monkeypatch: pytest.MonkeyPatch,
    every: int,
    epochs: list[int],
) -> None:
    drawn: list[int] = []
    monkeypatch.setattr(LatentPicture, "_draw", lambda self, trainer, phase: drawn.append(trainer.current_epoch + 1))
    data = tiny.data_module(trajectory_file, batch_size=1024)
    make_trainer(LatentPicture(10, every), epochs=4).fit(Alignment(tiny.policy(data), []), datamodule=data)
    assert drawn == epochs


def test_the_picture_goes_to_tensorboard_and_beside_it(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file, batch_size=1024)
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    phase = Alignment(tiny.policy(data), [])
    make_trainer(LatentPicture(samples=10), epochs=1, logger=logger).fit(phase, datamodule=data)
    assert (tmp_path / "alignment" / "latents.png").read_bytes().startswith(b"\x89PNG")
    events = b"".join(file.read_bytes() for file in (tmp_path / "alignment").glob("events*"))
    assert b"latents" in events
