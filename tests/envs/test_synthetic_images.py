from __future__ import annotations

import pickle

import numpy as np
import pytest

from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.synthetic import LinearPointExpert, SeenPoint

COLOURS = ("red", "green", "blue")


def brightest(image: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(np.argmax(image), image.shape)
    return int(row), int(column)


def shown(simulator: SeenPoint, colours: np.ndarray, point: tuple[float, float]) -> np.ndarray:
    """What the camera shows of one episode with spots and point where they are asked to be."""
    simulator.reset(["red"], [0])
    simulator.colours, simulator.point = colours[None], np.array([point])
    image = simulator._observe(np.arange(1)).images["camera"]
    assert image is not None
    return image[0]


def test_tasks_are_colours_and_the_others_are_proxies() -> None:
    assert SeenPoint(1).tasks.names == COLOURS
    assert SeenPoint(1).tasks.proxies("blue") == ("red", "green")


def test_the_spec_is_what_comes_out() -> None:
    simulator = SeenPoint(1, state_size=3, image_size=12)
    spec, observation = simulator.spec("left"), simulator.reset(["red", "blue"], [1, 2])
    assert observation.images["camera"].shape == (2, *spec.image_keys[0].shape) == (2, 12, 12, 3)
    assert observation.images["camera"].dtype == np.uint8
    assert observation.state.shape == (2, spec.state_size) == (2, 3)


def test_each_colour_has_a_place_of_its_own_in_an_order_of_the_seed() -> None:
    spots = SeenPoint(1).spots(range(200))
    angles = (np.round(np.degrees(np.arctan2(spots[..., 1], spots[..., 0]))).astype(int) % 360).tolist()
    orders, counts = np.unique(angles, axis=0, return_counts=True)
    assert sorted(map(tuple, orders.tolist())) == sorted(
        [(0, 120, 240), (0, 240, 120), (120, 0, 240), (120, 240, 0), (240, 0, 120), (240, 120, 0)]
    )
    assert counts.min() > 15
    np.testing.assert_allclose(np.linalg.norm(spots, axis=-1), 1)


def test_domains_show_the_same_order_for_the_same_seed() -> None:
    np.testing.assert_array_equal(SeenPoint(1).spots([5, 6]), SeenPoint(2).spots([5, 6]))


def test_a_spot_shines_in_its_colour_where_the_camera_sees_it() -> None:
    simulator = SeenPoint(1, image_size=27)  # pixels are 0.1 apart: place 0 is pixel 13
    simulator.view = np.eye(2)
    far = 9.0
    spots = np.array([[0.5, -1.0], [-0.2, 0.3], [far, far]])
    image = shown(simulator, spots, (far, far))
    assert brightest(image[..., 0]) == (18, 3)
    assert brightest(image[..., 1]) == (11, 16)
    assert image[..., 2].max() == 0
    white = shown(simulator, np.full((3, 2), far), (0.1, 0.4))
    assert brightest(white[..., 0]) == brightest(white[..., 2]) == (14, 17)
    np.testing.assert_array_equal(white[..., 0], white[..., 1])
    simulator.view = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert brightest(shown(simulator, spots, (far, far))[..., 0]) == (23, 18)


def test_the_state_does_not_tell_where_the_goal_is() -> None:
    one, other = (SeenPoint(1).reset([task], [3]) for task in ("red", "green"))
    np.testing.assert_array_equal(one.state, other.state)
    np.testing.assert_array_equal(one.images["camera"], other.images["camera"])


@pytest.mark.parametrize("task", COLOURS)
def test_the_expert_finds_every_spot(task: str) -> None:
    simulator, expert, seeds = SeenPoint(4), LinearPointExpert(), list(range(12))
    expert.begin(simulator, [task] * 12, seeds)
    assert rollout(simulator, expert.act, [task] * 12, seeds).success.all()


def test_an_episode_depends_on_its_seed_alone() -> None:
    together = SeenPoint(3).reset(["red", "blue"], [5, 6])
    alone = SeenPoint(3).reset(["blue"], [6])
    np.testing.assert_array_equal(together.images["camera"][1], alone.images["camera"][0])
    sent = pickle.loads(pickle.dumps(SeenPoint(3, state_size=5, image_size=9))).reset(["red"], [5])
    np.testing.assert_array_equal(
        sent.images["camera"], SeenPoint(3, 5, image_size=9).reset(["red"], [5]).images["camera"]
    )
