from __future__ import annotations

import numpy as np
import pytest

from datamodules.types import Observation
from plp_lightning.envs.maze.simulator import PointMaze
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert, SeenPoint
from plp_lightning.evaluation.simulation import EvalSetting
from plp_lightning.pictures.film_figure import BORDER, CAPTION, IMAGES, TILE, film_figure, film_frames, strip
from plp_lightning.pictures.films import Film, FilmRecorder, film_recorders
from plp_lightning.pictures.path_figure import FAILED, SOLVED
from plp_lightning.pictures.paths import path_recorders

TASKS, SEEDS = ["red", "green", "blue", "red", "green"], [3, 4, 5, 6, 7]


def recorded(most: int, lost: int) -> tuple[FilmRecorder, np.ndarray]:
    """The expert's episodes, of which ``lost`` stands still; and which were solved."""
    recorder, expert = FilmRecorder(SeenPoint(1, image_size=9, horizon=30), most), LinearPointExpert()

    def act(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        if len(episodes) == len(TASKS):
            expert.begin(recorder.simulator, TASKS, SEEDS)
        return expert.act(observation, episodes) * (episodes != lost)[:, None]

    return recorder, rollout(recorder, act, TASKS, SEEDS).success


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
    seen, watched = (SeenPoint(1, image_size=9) for _ in range(2))
    recorder, rng, rows = FilmRecorder(watched, 2), np.random.default_rng(0), np.arange(3)
    images = [seen.reset(TASKS[:3], SEEDS[:3]).image]
    recorder.reset(TASKS[:3], SEEDS[:3])
    for actions in rng.uniform(-1, 1, (4, 3, 2)):
        images.append(seen.step(actions, rows).observation.image)
        recorder.step(actions, rows)
    for episode, found in enumerate(recorder.films(2)):
        np.testing.assert_array_equal(found.images, np.stack([image[episode] for image in images if image is not None]))


def test_a_reset_forgets_earlier_episodes() -> None:
    recorder = FilmRecorder(SeenPoint(1), 5)
    recorder.reset(TASKS, SEEDS)
    recorder.reset(["blue"], [0])
    (only,) = recorder.films(5)
    assert (only.task, len(only.images)) == ("blue", 1)


def test_it_answers_as_the_simulator_does() -> None:
    simulator = SeenPoint(2)
    recorder = FilmRecorder(simulator, 1)
    assert (recorder.tasks, recorder.horizon) == (simulator.tasks, simulator.horizon)
    assert recorder.proxy_tasks("red") == ("green", "blue")
    assert recorder.target_tasks("red") == ("red",)
    assert recorder.spec("a") == simulator.spec("a")
    state = simulator.reset(["red"], [0]).state
    np.testing.assert_array_equal(recorder.shared_position(state), simulator.shared_position(state))


def test_domains_with_cameras_alone_are_filmed_and_not_without_room() -> None:
    simulators = {"seen": SeenPoint(1), "blind": LinearPoint(1)}
    trials = {"target": EvalSetting("seen", ("red",)), "source": EvalSetting("blind", ("goal_0",))}
    assert [*film_recorders(simulators, trials, most=4)] == ["target"]
    assert film_recorders(simulators, trials, most=0) == {}


def test_a_film_recorder_watches_through_another_recorder() -> None:
    other = FilmRecorder(SeenPoint(1), 3)
    trials = {"target": EvalSetting("seen", ("red",))}
    (recorder,) = film_recorders({"seen": other.simulator}, trials, 2, {"target": other}).values()
    recorder.reset(TASKS, SEEDS)
    assert [len(recorder.films(9)), len(other.films(9))] == [2, 3]
    assert not path_recorders({"seen": SeenPoint(1)}, trials)
    assert FilmRecorder(PointMaze("umaze"), 1).floor_plan() is not None


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
    assert {frame.shape for frame in frames} == {(2 * (CAPTION + side), 2 * side, 3)}
    middle = CAPTION + side // 2
    # Times 0, 2, 4 and the last, 5; a film that is over waits at its last image.
    assert [int(f[middle, side // 2, 0]) for f in frames] == [0, 2, 4, 5]
    assert [int(f[middle, side + side // 2, 0]) for f in frames] == [0, 2, 2, 2]
    assert [int(f[middle + CAPTION + side, side // 2, 0]) for f in frames] == [0, 2, 3, 3]
    edges = ["#{:02X}{:02X}{:02X}".format(*frames[0][middle, column]) for column in (0, side)]
    assert edges == [FAILED, SOLVED]
    assert (frames[0][middle + CAPTION + side, side:] == 255).all()


@pytest.mark.parametrize("size", [9, 64, 128])
def test_small_images_are_enlarged_by_whole_pixels(size: int) -> None:
    images = np.zeros((1, size, size, 3), np.uint8)
    (frame,) = film_frames({"one": [Film("red", True, images)]})
    assert (frame.shape[1] - 2 * BORDER) % size == 0
    assert TILE <= frame.shape[1] - 2 * BORDER < TILE + size
