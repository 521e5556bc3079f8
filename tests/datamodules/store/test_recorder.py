"""Recording one demonstration at a time: on disk at once, in constant time, to the same file as all at once."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import h5py
import pytest
from demonstrations import ARM, CAMERA, SPECS, TASKS, WHY, demonstration, demonstrations

from datamodules.errors import TrajectoryFileError
from datamodules.store import recorder
from datamodules.store.reader import TrajectoryFile, verify_hashes
from datamodules.store.recorder import Recorder, join_parts, part_files, parts_folder
from datamodules.store.writer import add_trajectories, write_trajectories


@pytest.fixture
def once(tmp_path: Path) -> Path:
    path = tmp_path / "once.hdf5"
    write_trajectories(path, SPECS, TASKS, demonstrations(), WHY)
    return path


def test_one_by_one_gives_the_bytes_of_all_at_once(tmp_path: Path, once: Path) -> None:
    with Recorder(tmp_path / "new" / "x.hdf5", SPECS, TASKS, WHY) as recording:
        for one in reversed(demonstrations()):
            recording.add([one])
    assert recording.added == len(demonstrations())
    assert (tmp_path / "new" / "x.hdf5").read_bytes() == once.read_bytes()
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["x.hdf5"]


def test_a_recorder_that_was_killed_has_lost_nothing(tmp_path: Path, once: Path) -> None:
    path, made = tmp_path / "x.hdf5", demonstrations()
    killed = Recorder(path, SPECS, TASKS, WHY)
    for one in made[:5]:
        killed.add([one])
    assert not path.exists()
    with Recorder(path, SPECS, TASKS, WHY) as recording:
        with TrajectoryFile.open(path) as file:
            assert sum(sum(tasks.values()) for tasks in file.counts().values()) == 5
        recording.add(made[5:])
    assert path.read_bytes() == once.read_bytes()


def test_each_addition_writes_itself_and_nothing_else(tmp_path: Path, once: Path) -> None:
    recording, before = Recorder(once, SPECS, TASKS, WHY), once.stat()
    for seed in range(10, 20):
        recording.add([demonstration(CAMERA, "lift", seed)])
        assert len(part_files(once)) == seed - 9
    assert once.stat() == before
    assert len({part.stat().st_size for part in part_files(once)}) == 1
    for part in part_files(once):
        verify_hashes(part)


def test_equal_seeds_stay_in_the_order_of_their_recording(tmp_path: Path) -> None:
    made = [demonstration(ARM, "lift", 0, steps) for steps in (9, 3, 7, 5, 4, 8)]
    with Recorder(tmp_path / "x", [ARM], TASKS, WHY) as recording:
        for one in made:
            recording.add([one])
    with TrajectoryFile.open(tmp_path / "x") as file:
        assert [len(file.trajectory("arm", n)) for n in range(6)] == [9, 3, 7, 5, 4, 8]


def test_more_parts_than_may_be_open(tmp_path: Path, once: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "OPEN_PARTS", 2)
    path = tmp_path / "x.hdf5"
    recording = Recorder(path, SPECS, TASKS, WHY)
    for one in demonstrations():
        recording.add([one])
    before = len(os.listdir("/proc/self/fd"))
    join_parts(path)
    assert len(os.listdir("/proc/self/fd")) == before
    assert path.read_bytes() == once.read_bytes()


def record(path: Path, tasks: Sequence[str], ending: BaseException | None = None) -> None:
    with Recorder(path, SPECS, tasks, WHY) as recording:
        recording.add([demonstration(ARM, "reach", 1)])
        if ending:
            raise ending
        recording.add([demonstration(ARM, "lift", 2)])


def test_an_error_keeps_what_was_added(tmp_path: Path) -> None:
    path = tmp_path / "x"
    with pytest.raises(TrajectoryFileError, match="an unknown task"):
        record(path, TASKS[:1])
    with TrajectoryFile.open(path) as file:
        assert file.episodes("arm").seed.tolist() == [1]


def test_who_has_to_leave_leaves_much_to_the_next_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "QUICK_BYTES", 10)
    path = tmp_path / "x"
    with pytest.raises(KeyboardInterrupt):
        record(path, TASKS, KeyboardInterrupt())
    assert not path.exists()
    join_parts(path)
    assert path.exists()
    assert not parts_folder(path).exists()


def test_files_of_others_in_the_folder_of_parts_stay(tmp_path: Path) -> None:
    path = tmp_path / "x"
    with Recorder(path, SPECS, TASKS, WHY) as recording:
        recording.add([demonstration(ARM, "reach", 1)])
        (parts_folder(path) / "notes.txt").write_text("mine")
        (parts_folder(path) / ".00000000-a.hdf5.b.tmp").write_text("left by a killed writer")
    assert [file.name for file in parts_folder(path).iterdir()] == ["notes.txt"]


def test_parts_stand_beside_the_file_that_a_link_leads_to(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "x.hdf5").symlink_to(tmp_path / "store" / "far.hdf5")
    with Recorder(tmp_path / "x.hdf5", SPECS, TASKS, WHY) as recording:
        recording.add([demonstration(ARM, "reach", 1)])
        assert parts_folder(tmp_path / "x.hdf5") == tmp_path / "store" / "far.hdf5.parts"
    assert (tmp_path / "x.hdf5").is_symlink()
    verify_hashes(tmp_path / "store" / "far.hdf5")


def test_what_cannot_grow_is_refused_before_anything_is_recorded(once: Path) -> None:
    with h5py.File(once, "a") as file:
        file["extra"] = [1]
    with pytest.raises(TrajectoryFileError, match="found /extra; growing would drop it"):
        Recorder(once, SPECS, TASKS, WHY)


def test_images_of_copies_alone_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Growing a file compares images only where everything else is equal."""
    path = tmp_path / "x"
    write_trajectories(path, [CAMERA], TASKS, [demonstration(CAMERA, "lift", 0, steps) for steps in (3, 4, 5)], WHY)
    asked: list[object] = []
    images = TrajectoryFile.images
    monkeypatch.setattr(TrajectoryFile, "images", lambda *words: asked.append(words) or images(*words))
    add_trajectories(path, [CAMERA], TASKS, [demonstration(CAMERA, "lift", 0, 9)], WHY)
    assert len(asked) == 3  # each once, to be written anew
