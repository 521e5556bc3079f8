"""Domains of several cameras, and of images alone, go out to other projects and come back as they were."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cameras
import gymnasium
import numpy as np
import pytest
from command import complaint, plp

from datamodules.store.writer import TrajectoryFile
from plp_lightning import Recorder

FORMATS: dict[str, list[str]] = {
    "robomimic": [],
    "minari": [],
    "minari arrow": ["--layout", "arrow"],
    "lerobot": [],
    "lerobot 2.1": ["--version", "2.1"],
}


@pytest.mark.parametrize("spec", [cameras.TWO, cameras.EYES], ids=lambda spec: spec.name)
@pytest.mark.parametrize("name", FORMATS)
def test_every_camera_goes_out_and_comes_back(name: str, spec: Any, tmp_path: Path) -> None:
    form, source, out = name.split()[0], cameras.write(tmp_path / "ours.hdf5"), tmp_path / "theirs"
    answer = plp("data", "export", form, source, "--domain", spec.name, "--out", out, *FORMATS[name])
    assert answer.code == 0, answer
    words = ["--domain", spec.name, "--fps", spec.control_hz, "--out", tmp_path / "back.hdf5"]
    answer = plp("data", "import", form, out, *words)
    assert answer.code == 0, answer
    with TrajectoryFile.open(source) as ours, TrajectoryFile.open(tmp_path / "back.hdf5") as back:
        sizes = [{key.name.rpartition(".")[2]: key.shape for key in f.spec(spec.name).image_keys} for f in (ours, back)]
        assert sizes[0] == sizes[1]
        for number in range(9):
            one, other = ours.trajectory(spec.name, number), back.trajectory(spec.name, number)
            rows = len(other.observation.state)
            np.testing.assert_array_equal(one.observation.state[:rows], other.observation.state)
            for key, images in other.observation.images.items():
                np.testing.assert_array_equal(one.observation.images[key.rpartition(".")[2]][:rows], images)


def test_what_d4rl_has_no_place_for_is_told(tmp_path: Path) -> None:
    words = ["data", "export", "d4rl", cameras.write(tmp_path / "ours.hdf5"), "--out", tmp_path / "theirs.hdf5"]
    assert "has no place there: images" in plp(*words, "--domain", "two").out
    told = complaint(*words[:-1], tmp_path / "other.hdf5", "--domain", "eyes")
    assert "found images alone in domain 'eyes'; expected a state" in told
    assert not (tmp_path / "other.hdf5").exists()


SIZES = {"front": (4, 5, 3), "wrist": (3, 3, 1)}


class Watched(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Shows two images and nothing else, for four steps."""

    def __init__(self) -> None:
        spaces = {name: gymnasium.spaces.Box(0, 255, size, np.uint8) for name, size in SIZES.items()}
        self.observation_space = gymnasium.spaces.Dict(spaces)  # type: ignore[assignment]
        self.action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self.steps = 0
        return self.look(), {}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        return self.look(), 0.0, self.steps == 4, False, {}

    def look(self) -> dict[str, np.ndarray]:
        return {name: np.full(size, self.steps, np.uint8) for name, size in SIZES.items()}


def test_recordings_of_several_images_come_in(tmp_path: Path) -> None:
    env = Recorder(Watched(), tmp_path / "rec", task="look", fps=10)
    env.reset(seed=0)
    for _ in range(4):
        env.step(np.zeros(1, np.float32))
    words = ["--domain", "eye", "--resize", "wrist=6x6", "--out", tmp_path / "x.hdf5"]
    answer = plp("data", "import", "gymnasium", tmp_path / "rec", *words)
    assert answer.code == 0, answer
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        seen = file.trajectory("eye", 0).observation
    assert seen.state.shape == (5, 0)
    assert {name: image.shape for name, image in seen.images.items()} == {"front": (5, 4, 5, 3), "wrist": (5, 6, 6, 1)}
    assert seen.images["wrist"][:, 0, 0, 0].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--image", "eye", "--image", "eye"], "--image is eye eye; expected every key once"),
        (["--image", "ear"], "found no 'ear'"),
        (["--image", "front", "--without_images"], "--image and --without_images contradict each other"),
        (["--state", "tip", "--without_state"], "--state and --without_state contradict each other"),
        (["--without_state", "--without_images"], "no vector to make a state of, and no camera"),
        (["--resize", "ear=4x4"], "--resize: found no 'ear'"),
        (["--resize", "wide=4"], "expected height and width in pixels, or KEY=HEIGHTxWIDTH"),
        (["--resize", "4", "4", "4"], "expected height and width in pixels, or KEY=HEIGHTxWIDTH"),
        (["--resize", "wide=0x4"], "expected height and width in pixels, or KEY=HEIGHTxWIDTH"),
    ],
    ids=str,
)
def test_options_that_do_not_fit_are_told(options: list[str], told: str, tmp_path: Path) -> None:
    out = tmp_path / "theirs.hdf5"
    plp("data", "export", "robomimic", cameras.write(tmp_path / "ours.hdf5"), "--domain", "two", "--out", out)
    words = ["data", "import", "robomimic", out, "--domain", "two", "--out", tmp_path / "x.hdf5"]
    assert told in complaint(*words, *options)
    assert not (tmp_path / "x.hdf5").exists()
