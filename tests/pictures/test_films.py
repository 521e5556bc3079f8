from __future__ import annotations

import numpy as np
import pytest

from datamodules.types import Observation
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert, SeenPoint
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.films import (
    IMAGES,
    TILE,
    Film,
    FilmRecorder,
    film_figure,
    film_frames,
    film_recorders,
    strip,
)
from plp_lightning.pictures.movies import BORDER, LINE
from plp_lightning.pictures.paths import FAILED, SOLVED

TASKS, SEEDS = ["red", "green", "blue", "red", "green"], [3, 4, 5, 6, 7]


def recorded(most: int, lost: int) -> tuple[FilmRecorder, np.ndarray]:
    """The expert's episodes, of which ``lost`` stands still; and which were solved."""
    recorder, expert, simulator = FilmRecorder(most), LinearPointExpert(), SeenPoint(1, image_size=9, horizon=30)

    def act(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        if len(episodes) == len(TASKS):
            expert.begin(simulator, TASKS, SEEDS)
        return expert.act(observation, episodes) * (episodes != lost)[:, None]

    return recorder, rollout(simulator, act, TASKS, SEEDS, observers=[recorder]).success


def film(length: int, success: bool, task: str = "red") -> Film:
    """Image t of a film is t all over."""
    times = np.arange(length, dtype=np.uint8)
    return Film(task, success, np.broadcast_to(times[:, None, None, None], (length, 32, 32, 3)))


def test_failures_come_first_and_the_rest_in_order() -> None:
    recorder, success = recorded(most=5, lost=2)
    assert success.tolist() == [True, True, False, True, True]
    films = recorder.films(4)
    assert [(f.task, f.success) for f in films] == [("blue", False), ("red", True), ("green", True), ("red", True)]
    assert films[0].images.shape == (31, 9, 9, 3)


def test_only_the_first_episodes_are_kept() -> None:
    recorder, _ = recorded(most=2, lost=4)
    assert [f.success for f in recorder.films(9)] == [True, True]


def test_images_are_those_that_stepping_by_hand_shows() -> None:
    simulator, recorder = SeenPoint(1, image_size=9, horizon=4), FilmRecorder(2)
    actions, rows = np.random.default_rng(0).uniform(-1, 1, (4, 3, 2)), np.arange(3)
    images = [simulator.reset(TASKS[:3], SEEDS[:3]).images["camera"]]
    images += [simulator.step(action, rows).observation.images["camera"] for action in actions]
    script = iter(actions)
    rollout(simulator, lambda seen, running: next(script), TASKS[:3], SEEDS[:3], observers=[recorder])
    for episode, found in enumerate(recorder.films(2)):
        np.testing.assert_array_equal(found.images, np.stack([image[episode] for image in images if image is not None]))


def test_a_new_beginning_forgets_earlier_episodes() -> None:
    recorder, _ = recorded(most=5, lost=0)
    recorder.begin(["blue"], [0], SeenPoint(1).reset(["blue"], [0]))
    (only,) = recorder.films(5)
    assert (only.task, only.success, len(only.images)) == ("blue", False, 1)


def test_domains_with_cameras_alone_are_filmed_and_not_without_room() -> None:
    simulators = {"seen": SeenPoint(1), "blind": LinearPoint(1)}
    trials = {"target": EvalSetting("seen", ("red",)), "source": EvalSetting("blind", ("goal_0",))}
    assert [*film_recorders(simulators, trials, most=4)] == ["target"]
    assert film_recorders(simulators, trials, most=0) == {}


def test_a_strip_holds_first_last_and_evenly_between() -> None:
    shown = strip(film(length=15, success=True))
    assert shown.shape == (32, 33 * IMAGES - 1, 3)
    assert shown[0, ::33, 0].tolist() == [0, 2, 4, 6, 8, 10, 12, 14]
    assert (shown[:, 32::33] == 255).all()


def test_a_film_shorter_than_its_strip_repeats_images() -> None:
    assert strip(film(length=1, success=True))[0, ::33, 0].tolist() == [0] * IMAGES


def test_a_figure_tells_what_is_shown_and_how_it_ended() -> None:
    reels = {"there": [film(31, False), film(9, True, "blue")], "here": [film(5, True)]}
    axes = film_figure(reels).axes
    labels = [a.get_ylabel().split("\n") for a in axes if a.images]
    assert sorted(labels) == [
        ["blue", "solved", "8 steps"],
        ["red", "failed", "30 steps"],
        ["red", "solved", "4 steps"],
    ]
    colours = {a.get_ylabel().split("\n")[1]: a.yaxis.label.get_color() for a in axes if a.images}
    assert colours["failed"] != colours["solved"]
    assert [a.get_title() for a in axes if a.get_title()] == ["there", "here"]


def test_frames_hold_every_film_with_its_end_around_it() -> None:
    reels = {"there": [film(6, False), film(3, True)], "here": [film(4, True)]}
    frames = film_frames(reels)
    side = TILE + 2 * BORDER
    assert {frame.shape for frame in frames} == {(2 * (LINE + side), 2 * side, 3)}
    middle = LINE + side // 2
    # Times 0, 2, 4 and the last, 5; a film that is over waits at its last image.
    assert [int(f[middle, side // 2, 0]) for f in frames] == [0, 2, 4, 5]
    assert [int(f[middle, side + side // 2, 0]) for f in frames] == [0, 2, 2, 2]
    assert [int(f[middle + LINE + side, side // 2, 0]) for f in frames] == [0, 2, 3, 3]
    edges = ["#{:02X}{:02X}{:02X}".format(*frames[0][middle, column]) for column in (0, side)]
    assert edges == [FAILED, SOLVED]
    assert (frames[0][middle + LINE + side, side:] == 255).all()


@pytest.mark.parametrize("size", [9, 64, 128])
def test_small_images_are_enlarged_by_whole_pixels(size: int) -> None:
    images = np.zeros((1, size, size, 3), np.uint8)
    (frame,) = film_frames({"one": [Film("red", True, images)]})
    assert (frame.shape[1] - 2 * BORDER) % size == 0
    assert TILE <= frame.shape[1] - 2 * BORDER < TILE + size
