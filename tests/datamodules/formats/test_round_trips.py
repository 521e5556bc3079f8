"""What goes out to another project's format and comes in again is the same, bit for bit."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command import complaint, plp

from datamodules.store import schema
from datamodules.store.writer import TrajectoryFile, write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory

TASKS = ["lift_the_lid", "push the red block", "schieb den Klötzchen-Turm 😀 um"]
LIMITS = {"plain": {}, "limited": {"action_low": (-0.3, -7.0), "action_high": (2.9, 11.0)}}
KEYS = (ObservationKey("joint_pos", (3,), unit="rad"), ObservationKey("ee_pos", (2,)))
CAMERA = ObservationKey("eye", (6, 5, 3), "image")
FORMATS = {
    "robomimic": ("robomimic", "x.hdf5", []),
    "minari": ("minari", "x", []),
    "minari arrow": ("minari", "x", ["--layout", "arrow"]),
    "lerobot": ("lerobot", "x", []),
    "lerobot 2.1": ("lerobot", "x", ["--version", "2.1"]),
    "d4rl": ("d4rl", "x.hdf5", []),
}
LOSES_LAST = ("lerobot", "lerobot 2.1")


def demonstrations(seen: bool, last: bool) -> Iterator[Trajectory]:
    random = np.random.default_rng(0)
    for number in range(6):
        steps = int(random.integers(1, 6))
        state = random.normal(size=(steps + last, 5)).astype(np.float32)
        actions = random.uniform(-1, 1, size=(steps, 2)).astype(np.float32)
        actions[0] = [1, -1]
        images = {"eye": random.integers(0, 256, size=(steps + last, 6, 5, 3), dtype=np.uint8)} if seen else {}
        task = TASKS[number % 3]
        yield Trajectory(
            "arm",
            task,
            Observation(state, images),
            actions,
            number // 3,
            success=number != 4,
        )


def ours(path: Path, limits: str = "plain", seen: bool = True, last: bool = True) -> Path:
    keys = (*KEYS, CAMERA) if seen else KEYS
    spec = DomainSpec("arm", keys, 2, 12.5, "made up", **LIMITS[limits])  # type: ignore[arg-type]
    write_trajectories(path, [spec], TASKS, demonstrations(seen, last), {"command": "tests"})
    return path


def there_and_back(tmp_path: Path, name: str, source: Path, *options: object) -> tuple[TrajectoryFile, TrajectoryFile]:
    form, out, settings = FORMATS[name]
    answer = plp("data", "export", form, source, "--domain", "arm", "--out", tmp_path / out, *settings)
    assert answer.code == 0, answer
    back = tmp_path / "back.hdf5"
    answer = plp("data", "import", form, tmp_path / out, "--domain", "arm", "--out", back, "--fps", 12.5, *options)
    assert answer.code == 0, answer
    assert plp("data", "validate", back).code == 0
    return TrajectoryFile.open(source), TrajectoryFile.open(back)


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("name", FORMATS)
def test_round_trips_are_exact(tmp_path: Path, name: str, limits: str) -> None:
    seen = name != "d4rl"
    order = [] if name in ("d4rl", *LOSES_LAST) else ["--state", "joint_pos", "ee_pos"]
    one, other = there_and_back(tmp_path, name, ours(tmp_path / "ours.hdf5", limits, seen), *order)
    with one, other:
        assert other.tasks == one.tasks
        spec, found = one.spec("arm"), other.spec("arm")
        assert (found.action_low, found.action_high, found.control_hz) == (spec.action_low, spec.action_high, 12.5)
        for number in range(6):
            a, b = one.trajectory("arm", number), other.trajectory("arm", number)
            rows = len(a) if name in LOSES_LAST else len(a) + 1
            assert (a.task, a.success) == (b.task, b.success)
            assert name == "d4rl" or a.seed == b.seed
            np.testing.assert_array_equal(a.observation.state[:rows], b.observation.state)
            np.testing.assert_array_equal(a.actions, b.actions)
            if seen:
                np.testing.assert_array_equal(a.observation.images["eye"][:rows], *b.observation.images.values())


@pytest.mark.parametrize("name", ["robomimic", "lerobot", "d4rl"])
def test_unknown_last_observations_stay_unknown(tmp_path: Path, name: str) -> None:
    one, other = there_and_back(tmp_path, name, ours(tmp_path / "ours.hdf5", seen=False, last=False))
    with one, other:
        assert (other.episodes("arm").last == -1).all()
        state = one.read("arm").state if name != "robomimic" else one.read("arm").state[:, [3, 4, 0, 1, 2]]
        np.testing.assert_array_equal(other.read("arm").state, state)


def test_minari_wants_last_observations(tmp_path: Path) -> None:
    source = ours(tmp_path / "ours.hdf5", seen=False, last=False)
    told = complaint("data", "export", "minari", source, "--domain", "arm", "--out", tmp_path / "x")
    assert "found 6 demonstrations without a last observation; expected T + 1" in told
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_there_is_not_written_over(tmp_path: Path, name: str) -> None:
    form, _, settings = FORMATS[name]
    source = ours(tmp_path / "ours.hdf5", seen=False)
    before = source.read_bytes()
    told = complaint("data", "export", form, source, "--domain", "arm", "--out", source, *settings)
    assert "exists; expected a new name" in told
    assert source.read_bytes() == before
    told = complaint("data", "export", form, source, "--domain", "leg", "--out", tmp_path / "new", *settings)
    assert "no domain 'leg'; it has: arm" in told
    assert [path.name for path in tmp_path.iterdir()] == ["ours.hdf5"]


def test_what_has_no_place_in_a_format_is_told(tmp_path: Path) -> None:
    source = ours(tmp_path / "ours.hdf5")
    told = plp("data", "export", "lerobot", source, "--domain", "arm", "--out", tmp_path / "x").out
    assert "has no place there: last observations of 6 demonstrations" in told
    told = plp("data", "export", "d4rl", source, "--domain", "arm", "--out", tmp_path / "y").out
    assert "has no place there: images" in told
    told = complaint("data", "export", "gymnasium", source, "--domain", "arm", "--out", tmp_path / "z")
    assert "can only be imported" in told


def test_images_stream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many images there are, those of one episode are in memory at a time."""
    monkeypatch.setattr(schema, "_HASH_BLOCK_BYTES", 2**18)
    keys = (KEYS[0], ObservationKey("eye", (64, 64, 3), "image"))
    episodes, steps = 36, 20
    image = np.random.default_rng(0).integers(0, 256, size=(steps + 1, 64, 64, 3), dtype=np.uint8)
    made = (
        Trajectory(
            "arm",
            "go",
            Observation(np.zeros((steps + 1, 3), np.float32), {"eye": image}),
            np.zeros((steps, 2)),
            i,
            True,
        )
        for i in range(episodes)
    )
    write_trajectories(tmp_path / "ours.hdf5", [DomainSpec("arm", keys, 2, 10.0)], ["go"], made, {})
    for form, out in (("robomimic", "x.hdf5"), ("lerobot", "x"), ("minari", "y")):
        words = [form, tmp_path / "ours.hdf5", "--domain", "arm", "--out", tmp_path / out]
        for verb, *rest in (
            ("export", *words),
            ("import", form, tmp_path / out, *words[2:-1], tmp_path / f"{form}.hdf5"),
        ):
            tracemalloc.start()
            answer = plp("data", verb, *rest, *(["--fps", 10] if verb == "import" else []))
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert answer.code == 0, answer
            assert peak < episodes * image.nbytes / 2, f"{verb} {form}: {peak / image.nbytes:.1f} episodes"
