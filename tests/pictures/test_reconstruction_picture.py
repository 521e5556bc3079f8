from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import seen
import tiny
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.image import imread
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from plp_lightning.evaluation.scores import encode, sample_states
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.terms import ImageReconstruction
from plp_lightning.pictures.reconstructions import (
    ReconstructionPicture,
    reconstruction_figure,
    reconstructions,
)


def test_each_domains_own_images_are_shown_and_what_the_decoder_makes_of_them(seen_file: Path) -> None:
    data = seen.data_module(seen_file)
    phase = Alignment(seen.policy(data), tiny.terms())
    term = phase.terms["reconstruction"]
    assert isinstance(term, ImageReconstruction)
    found = reconstructions(phase, data, 5)
    assert [*found] == ["left", "right"]
    for domain, (images, made) in found.items():
        states = sample_states(data, domain, 5)
        np.testing.assert_array_equal(images, states.images["camera"].numpy())
        latent = encode(phase.policy, domain, states)
        again = term.reconstruct({domain: latent})[domain, "camera"]
        np.testing.assert_allclose(made, again.detach().numpy(), atol=1e-5)


def test_what_was_seen_is_above_what_was_made_of_it() -> None:
    left, right = (np.full((3, 4, 4, 3), grey, np.uint8) for grey in (10, 20))
    made = np.full((3, 2, 2, 3), 0.5)
    axes = reconstruction_figure({"left": (left, made), "right": (right[:2], made[:2])}).axes
    shown = [a.images[0].get_array() for a in axes if a.images]
    assert [image.shape[0] for image in shown] == [4, 4, 4, 2, 2, 2, 4, 4, 2, 2]
    assert [int(shown[i][0, 0, 0]) for i in (0, 6)] == [10, 20]
    texts = [text.get_text() for a in axes for text in a.texts]
    assert texts == ["left\nseen", "left\nreconstructed", "right\nseen", "right\nreconstructed"]


def test_the_last_epoch_leaves_the_picture(
    seen_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    data = seen.data_module(seen_file, batch_size=256)
    make_trainer(ReconstructionPicture(4), logger=logger).fit(
        Alignment(seen.policy(data), tiny.terms()), datamodule=data
    )
    logger.experiment.flush()
    events = EventAccumulator(logger.log_dir)
    events.Reload()
    (shown,) = events.Images("alignment/reconstructions")
    assert imread(Path(logger.log_dir) / "reconstructions.png").shape[:2] == (shown.height, shown.width)


def test_nothing_is_drawn_without_an_image_decoder(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    data = tiny.data_module(trajectory_file, batch_size=1024)
    make_trainer(ReconstructionPicture(4), logger=logger).fit(
        Alignment(tiny.policy(data), tiny.terms()), datamodule=data
    )
    assert not [*Path(logger.log_dir).glob("*.png")]
