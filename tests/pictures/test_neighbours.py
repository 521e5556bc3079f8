from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import seen
import tiny
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from plp_lightning.methods.plp import Alignment
from plp_lightning.pictures.latents import LatentPicture
from plp_lightning.pictures.neighbours import neighbour_figure, neighbour_pairs


def test_pairs_are_each_other_s_nearest_from_the_nearest_to_the_farthest() -> None:
    first = np.array([[0.0], [1.0], [5.0], [5.2], [9.0]])
    second = np.array([[5.1], [0.4], [9.05]])
    pairs = [(i, j) for i, j, _ in neighbour_pairs(first, second)]
    assert pairs == [(4, 2), (2, 0), (0, 1)]  # 1.0 is nearest to 0.4, but that is nearer to 0.0
    random = np.random.default_rng(0).normal(size=(2, 60, 3))
    found = neighbour_pairs(*random, 4)
    distances = np.linalg.norm(random[0][:, None] - random[1][None], axis=-1)
    assert [distance for *_, distance in found] == sorted(distance for *_, distance in found)
    assert len(found) == 4
    for i, j, distance in found:
        assert distance == distances[i].min() == distances[:, j].min() == distances[i, j]


def test_both_images_of_a_pair_stand_one_above_the_other() -> None:
    latents = {"left": np.array([[0.0], [5.0]]), "right": np.array([[5.5], [0.1]]), "third": np.zeros((2, 1))}
    images = {
        name: np.stack([np.full((4, 4, 3), 10 * k + i, np.uint8) for i in range(2)]) for k, name in enumerate(latents)
    }
    figure = neighbour_figure(latents, images)
    assert figure is not None
    assert [int(axes.images[0].get_array()[0, 0, 0]) for axes in figure.axes] == [0, 1, 11, 10]
    assert [axes.get_title() for axes in figure.axes[:2]] == ["0.1", "0.5"]
    assert neighbour_figure(latents, {"left": images["left"]}) is None
    assert neighbour_figure(latents, {}) is None


def test_the_picture_of_latent_states_leaves_that_of_neighbours_where_there_are_cameras(
    seen_file: Path, trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    for name, module, file in (("seen", seen, seen_file), ("blind", tiny, trajectory_file)):
        data = module.data_module(file, batch_size=256)
        logger = TensorBoardLogger(tmp_path, name=name, version="")
        phase = Alignment(module.policy(data), tiny.terms())
        make_trainer(LatentPicture(samples=10), epochs=1, logger=logger).fit(phase, datamodule=data)
        assert (tmp_path / name / "latents.png").is_file()
    assert (tmp_path / "seen" / "neighbours.png").is_file()
    assert not (tmp_path / "blind" / "neighbours.png").exists()
