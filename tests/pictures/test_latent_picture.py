from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
from lightning.pytorch import Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from matplotlib.collections import LineCollection, PathCollection

from datamodules.store.writer import TrajectoryFile
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.evaluation.scores import AlignmentScore, ClosenessScore, encode
from plp_lightning.methods.plp import Alignment
from plp_lightning.pictures import latents as latent_picture
from plp_lightning.pictures.latents import LatentPicture, latent_figure


def test_every_domain_has_its_points_and_its_colour() -> None:
    rng = np.random.default_rng(0)
    figure = latent_figure({"flat": rng.normal(size=(12, 4)), "tall": rng.normal(5, 1, (9, 4))})
    (axes,) = figure.axes
    assert [len(points.get_offsets()) for points in axes.collections] == [12, 9]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["flat", "tall"]
    colours = {tuple(points.get_facecolor()[0]) for points in axes.collections}
    assert len(colours) == 2


def test_corresponding_states_are_joined_and_nothing_else() -> None:
    rng = np.random.default_rng(0)
    latents = {"flat": rng.normal(size=(12, 4)), "tall": rng.normal(5, 1, (9, 4)), "third": rng.normal(9, 1, (7, 4))}
    pairs = {"third": latents["third"][:3], "flat": latents["flat"][[5, 1, 7]]}
    (axes,) = latent_figure(latents, pairs).axes
    (lines,) = (artist for artist in axes.collections if isinstance(artist, LineCollection))
    dots = [np.asarray(artist.get_offsets()) for artist in axes.collections if isinstance(artist, PathCollection)]
    assert [len(points) for points in dots] == [12, 9, 7, 3, 3]
    np.testing.assert_array_equal(np.array(lines.get_segments()), np.stack(dots[3:], axis=1))
    # A pair's ends wear the colours of their domains, and t-SNE puts equal states at about the same place.
    colours = [tuple(artist.get_facecolor()[0][:3]) for artist in axes.collections if artist is not lines]
    assert [colours[3], colours[4]] == [colours[2], colours[0]]
    assert axes.get_legend().get_texts()[-1].get_text() == "3 pairs of corresponding states"


def test_latents_of_one_number_can_be_drawn() -> None:
    (axes,) = latent_figure({"flat": np.arange(9.0)[:, None], "tall": np.arange(8.0)[:, None]}).axes
    assert [len(points.get_offsets()) for points in axes.collections] == [9, 8]


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
    make_trainer(LatentPicture(10, every), epochs=4).fit(Alignment(tiny.policy(data), tiny.terms()), datamodule=data)
    assert drawn == epochs


def test_the_picture_goes_to_tensorboard_and_beside_it(
    trajectory_file: Path, tmp_path: Path, make_trainer: Callable[..., Trainer]
) -> None:
    data = tiny.data_module(trajectory_file, batch_size=1024)
    logger = TensorBoardLogger(tmp_path, name="alignment", version="")
    phase = Alignment(tiny.policy(data), tiny.terms())
    make_trainer(LatentPicture(samples=10), epochs=1, logger=logger).fit(phase, datamodule=data)
    assert (tmp_path / "alignment" / "latents.png").read_bytes().startswith(b"\x89PNG")
    events = b"".join(file.read_bytes() for file in (tmp_path / "alignment").glob("events*"))
    assert b"latents" in events


class Ignorant(AlignmentScore):
    """Knows of no corresponding states."""

    def __call__(self, policy: object, data: object, simulators: object) -> dict[str, float]:
        return {}


@pytest.mark.parametrize(
    ("score", "pairs", "expected"),
    [(ClosenessScore(30), 4, 4), (ClosenessScore(30), 0, 0), (Ignorant(), 4, 0), (None, 4, 0)],
)
def test_the_score_says_which_states_are_joined(
    trajectory_file: Path,
    make_trainer: Callable[..., Trainer],
    monkeypatch: pytest.MonkeyPatch,
    score: AlignmentScore | None,
    pairs: int,
    expected: int,
) -> None:
    drawn: list[dict[str, np.ndarray]] = []
    monkeypatch.setattr(latent_picture, "publish", lambda *words: None)
    monkeypatch.setattr(latent_picture, "latent_figure", lambda latents, joined, kinds: drawn.append(joined))
    simulators = {name: domain.simulator for name, domain in tiny.domains().items()}
    data = tiny.data_module(trajectory_file, batch_size=1024)
    phase = Alignment(tiny.policy(data), tiny.terms())
    picture = LatentPicture(10, 0, pairs, score, simulators)
    make_trainer(picture, epochs=1).fit(phase, datamodule=data)
    (joined,) = drawn
    assert {domain: len(found) for domain, found in joined.items()} == ({"flat": 4, "tall": 4} if expected else {})
    for domain, states in (ClosenessScore(30).correspondences(data, simulators, 4) if expected else {}).items():
        np.testing.assert_array_equal(joined[domain], encode(phase.policy, domain, states).numpy())


def test_kinds_have_colours_in_a_second_plot_of_the_same_points() -> None:
    rng = np.random.default_rng(0)
    latents = {"flat": rng.normal(size=(12, 4)), "tall": rng.normal(5, 1, (9, 4))}
    kinds = {"flat": ["red first", "blue first"] * 6, "tall": ["red first"] * 9}
    first, second = latent_figure(latents, None, kinds).axes
    flat, tall = (np.asarray(points.get_offsets()) for points in first.collections)
    found = {
        points.get_label(): np.asarray(points.get_offsets())
        for points in second.collections
        if points.get_offsets().size
    }
    assert set(found) == {"red first, flat", "blue first, flat", "red first, tall"}
    np.testing.assert_array_equal(found["red first, flat"], flat[::2])
    np.testing.assert_array_equal(found["blue first, flat"], flat[1::2])
    np.testing.assert_array_equal(found["red first, tall"], tall)


def test_arrangements_are_those_of_the_episodes_that_states_belong_to(
    trajectory_file: Path, make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Arranged(LinearPoint):
        def arrangement(self, task: str, seed: int) -> str:
            return f"{task} {seed}"

    drawn: list[dict[str, list[str]]] = []
    monkeypatch.setattr(latent_picture, "publish", lambda *words: None)
    monkeypatch.setattr(latent_picture, "latent_figure", lambda latents, joined, kinds: drawn.append(kinds))
    data = tiny.data_module(trajectory_file, batch_size=1024)
    picture = LatentPicture(10, simulators={"flat": Arranged(1), "tall": LinearPoint(2)})
    make_trainer(picture, epochs=1).fit(Alignment(tiny.policy(data), tiny.terms()), datamodule=data)
    (kinds,) = drawn
    assert kinds["tall"] == []
    with TrajectoryFile.open(trajectory_file) as file:
        episodes = file.episodes("flat")
    known = {f"{task} {seed}" for task, seed in zip(episodes.task, episodes.seed, strict=True) if task in tiny.PROXIES}
    assert len(kinds["flat"]) == 10
    assert set(kinds["flat"]) <= known
