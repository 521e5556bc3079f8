"""Episodes of a Gymnasium environment are recorded one by one and imported with T + 1 observations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from command import complaint, plp

from datamodules.errors import ConfigError
from datamodules.store.writer import TrajectoryFile
from plp_lightning.recording import Recorder

TASKS = ("go left", "go right")


class Slider(gymnasium.Env[Any, Any]):
    """Slides a block; the action is its change in millimetres, from -20 to 20."""

    metadata = {"render_modes": [], "render_fps": 25}  # noqa: RUF012

    def __init__(self, seen: bool = True) -> None:
        box = gymnasium.spaces.Box
        self.seen = seen
        self.observation_space = gymnasium.spaces.Dict({"place": box(-1e3, 1e3, (1,)), "eye": box(0, 255, (4, 5, 3))})
        self.action_space = box(-20, 20, (1,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.normal(size=1).astype(np.float32), 0
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place += action
        self.steps += 1
        return self.observe(), 0.0, False, self.steps == 5, {"is_success": bool(self.place > 0)}

    def observe(self) -> Any:
        image = np.full((4, 5, 3), self.steps, np.uint8)
        return {"place": self.place, "eye": image} if self.seen else self.place  # the same array, every time


def record(folder: Path, seen: bool = True, episodes: int = 3, **settings: Any) -> list[np.ndarray]:
    env = Recorder(Slider(seen), folder, **settings)
    actions = np.random.default_rng(0).uniform(-20, 20, size=(episodes, 5, 1)).astype(np.float32)
    places = []
    for number in range(episodes):
        observation, _ = env.reset(seed=number, options={"task": TASKS[number % 2]})
        places.append([np.array(observation["place"] if seen else observation)])
        for action in actions[number]:
            observation = env.step(action)[0]
            places[-1].append(np.array(observation["place"] if seen else observation))
    return [np.stack(rows) for rows in places]


def test_recordings_come_in_with_all_that_was_seen(tmp_path: Path) -> None:
    places = record(tmp_path / "rec")
    answer = plp("data", "import", "gymnasium", tmp_path / "rec", "--domain", "slider", "--out", tmp_path / "x.hdf5")
    assert answer.code == 0, answer
    assert "actions from (-20) to (20); limits: as the source tells" in answer.out
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        spec = file.spec("slider")
        assert (spec.control_hz, spec.env, spec.action_low, spec.action_high) == (25, "Slider", (-20,), (20,))
        assert file.tasks == TASKS
        found = {(t.task, t.seed): t for t in (file.trajectory("slider", number) for number in range(3))}
    for number, place in enumerate(places):
        one = found[TASKS[number % 2], number]
        np.testing.assert_array_equal(one.observation.state, place)
        assert one.observation.images["eye"][:, 0, 0, 0].tolist() == [0, 1, 2, 3, 4, 5]
        assert one.success == bool(place[-1] > 0)
        np.testing.assert_allclose(spec.owner_actions(one.actions), np.diff(place, axis=0), atol=1e-5)


def test_a_recording_grows_and_keeps_only_whole_episodes(tmp_path: Path) -> None:
    record(tmp_path / "rec", seen=False, episodes=2)
    env = Recorder(Slider(False), tmp_path / "rec", task="stay")
    env.reset(seed=7)
    env.step(np.zeros(1, np.float32))
    env.reset(seed=8)
    for _ in range(5):
        env.step(np.zeros(1, np.float32))
    assert sorted(path.name for path in (tmp_path / "rec").glob("*.hdf5")) == [
        f"episode_{number:06d}.hdf5" for number in range(3)
    ]
    plp("data", "import", "gymnasium", tmp_path / "rec", "--domain", "slider", "--out", tmp_path / "x.hdf5")
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert file.tasks == (*TASKS, "stay")
        assert file.spec("slider").observation[0].name == "observation"


def test_recordings_of_two_robots_do_not_mix(tmp_path: Path) -> None:
    record(tmp_path / "rec", episodes=1)
    with pytest.raises(ConfigError, match=r"found a recording of .*'fps': 25.*; expected .*'fps': 5"):
        Recorder(Slider(), tmp_path / "rec", fps=5)


def test_no_episode_takes_the_place_of_another(tmp_path: Path) -> None:
    record(tmp_path / "rec", episodes=3)
    (tmp_path / "rec" / "episode_000000.hdf5").unlink()
    record(tmp_path / "rec", episodes=1)
    found = sorted(path.name for path in (tmp_path / "rec").glob("*.hdf5"))
    assert found == [f"episode_{number:06d}.hdf5" for number in (1, 2, 3)]


def test_a_damaged_recording_is_named(tmp_path: Path) -> None:
    record(tmp_path / "rec")
    words = ["data", "import", "gymnasium", tmp_path / "rec", "--domain", "slider", "--out", tmp_path / "x.hdf5"]
    (tmp_path / "rec" / "episode_000001.hdf5").write_bytes(b"nonsense")
    assert "episode_000001.hdf5: cannot be read as HDF5" in complaint(*words)
    (tmp_path / "rec" / "recording.json").write_text('{"env": "Slider", "action_low": ["a"]}')
    assert "action_low ['a']; expected 1 numbers" in complaint(*words)
    (tmp_path / "rec" / "recording.json").unlink()
    assert "recording.json: found no such file" in complaint(*words)


def test_a_discrete_environment_is_refused_when_it_is_wrapped(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"found actions of Discrete\(2\); expected a Box"):
        Recorder(gymnasium.make("CartPole-v1"), tmp_path / "rec")


class Mixed(Slider):
    """Shows numbers in dictionaries in tuples, and texts beside them."""

    def observe(self) -> Any:
        return {"arm": ({"place": self.place}, self.steps), "told": "left", "off": self.place < 0}


def test_numbers_are_recorded_wherever_they_stand_and_texts_are_not(tmp_path: Path) -> None:
    env = Recorder(Mixed(), tmp_path / "mixed", task="go left")
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.ones(1, np.float32))
    answer = plp("data", "import", "gymnasium", tmp_path / "mixed", "--domain", "d", "--out", tmp_path / "x.hdf5")
    assert answer.code == 0, answer
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert [(key.name, key.shape) for key in file.spec("d").observation] == [
            ("arm.0.place", (1,)),
            ("arm.1", (1,)),
            ("off", (1,)),
        ]
