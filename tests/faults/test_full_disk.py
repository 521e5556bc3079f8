"""A disk that takes no more: one line, the old file as it was, nothing left behind, and no crash in HDF5."""

from __future__ import annotations

import errno
import itertools
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datamodules.errors import TrajectoryFileError
from datamodules.store.atomic import write_atomically
from datamodules.store.patient import PatientFile
from datamodules.store.recorder import Recorder
from datamodules.store.writer import add_trajectories, verify_hashes, write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory
from plp_lightning.cli.failures import tell_of_threads

SPEC = DomainSpec("arm", (ObservationKey("joints", (3,)), ObservationKey("view", (16, 16, 3), "image")), 2, 10.0)
WHY = {"command": "tests"}
CALLS = (0, 1, 2, 3, 5, 8, 13, 21, 34, 55)


def demonstration(seed: int, steps: int = 40) -> Trajectory:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (steps + 1, 16, 16, 3), dtype=np.uint8)
    seen = Observation(rng.normal(size=(steps + 1, 3)).astype(np.float32), {"view": image})
    return Trajectory("arm", "lift", seen, rng.uniform(-1, 1, (steps, 2)).astype(np.float32), seed, True)


def full_after(calls: int, number: int = errno.ENOSPC) -> Callable[..., int]:
    """``os.pwrite`` of a disk that is full after so many calls; the last one finds room for a part."""
    pwrite, count = os.pwrite, itertools.count()

    def write(descriptor: int, block: memoryview, at: int) -> int:
        if (n := next(count)) > calls:
            raise OSError(number, os.strerror(number))
        return pwrite(descriptor, block[: len(block) // 2] if n == calls and len(block) > 1 else block, at)

    return write


@pytest.mark.parametrize("calls", CALLS)
@pytest.mark.parametrize("compress", [False, True])
def test_a_disk_that_fills_up_at_any_moment_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calls: int, compress: bool
) -> None:
    path = tmp_path / "x.hdf5"
    write_trajectories(path, [SPEC], ["lift"], [demonstration(0)], WHY)
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full_after(calls))
        with pytest.raises(TrajectoryFileError) as caught:
            add_trajectories(path, [SPEC], ["lift"], map(demonstration, range(1, 9)), WHY, compress)
    assert str(caught.value).startswith(f"{path}: cannot be written (No space left on device); expected a folder with")
    assert f"make room for {9 * (41 * (12 + 768) + 40 * 8)} bytes or choose another" in str(caught.value)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("number", [errno.EIO, errno.EDQUOT, errno.EFBIG])
def test_other_refusals_are_told_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    monkeypatch.setattr(os, "pwrite", full_after(4, number))
    with pytest.raises(TrajectoryFileError, match=os.strerror(number)):
        write_trajectories(tmp_path / "x", [SPEC], ["lift"], [demonstration(0)], WHY)
    assert list(tmp_path.iterdir()) == []


def test_not_much_more_than_one_episode_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held: list[int] = []
    close = PatientFile.close

    def counted(file: PatientFile) -> None:
        held.append(sum(len(block) for _, block in file._held))
        close(file)

    monkeypatch.setattr(PatientFile, "close", counted)
    monkeypatch.setattr(os, "pwrite", full_after(8))
    with pytest.raises(TrajectoryFileError):
        write_trajectories(tmp_path / "x", [SPEC], ["lift"], (demonstration(seed, 1000) for seed in range(40)), WHY)
    assert max(held) < 12 * 2**20 < 40 * 1001 * 768  # the rest is HDF5's cache of blocks


def refused(recorder: Recorder) -> bool:
    try:
        recorder.add([demonstration(recorder.added)])
    except TrajectoryFileError as error:
        return "No space left on device" in str(error)
    return False


@pytest.mark.parametrize("calls", [3, 30])
def test_a_recorder_keeps_what_found_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calls: int) -> None:
    path = tmp_path / "x.hdf5"
    recorder = Recorder(path, [SPEC], ["lift"], WHY)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full_after(calls))
        while recorder.added < 100 and not refused(recorder):
            pass
    assert recorder.added < 10
    assert not path.exists()
    assert (tmp_path / "x.hdf5.parts").exists() == (recorder.added > 0)
    with Recorder(path, [SPEC], ["lift"], WHY) as again:
        again.add([demonstration(seed) for seed in range(recorder.added, 3)])
    write_trajectories(tmp_path / "once", [SPEC], ["lift"], map(demonstration, range(3)), WHY)
    assert path.read_bytes() == (tmp_path / "once").read_bytes()


@pytest.mark.parametrize("calls", [0, 1, 2, 1000])
def test_a_patient_file_gives_back_all_that_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calls: int
) -> None:
    monkeypatch.setattr(os, "pwrite", full_after(calls))
    file, wanted, rng = PatientFile(tmp_path / "x"), np.zeros(500, np.uint8), np.random.default_rng(0)
    for _ in range(20):
        start, stop = np.sort(rng.integers(0, 501, 2))
        block = rng.integers(0, 256, stop - start, dtype=np.uint8)
        file.seek(int(start))
        assert file.write(block.tobytes()) == len(block)
        wanted[start:stop] = block
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    found = bytearray(600)
    assert file.readinto(found) == size
    assert bytes(found[:size]) == wanted[:size].tobytes()
    assert (file.refusal is None) == (calls == 1000)


def test_texts_name_the_file_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_atomically(tmp_path / "status.json", "{}")
    assert caught.value.filename == str(tmp_path / "status.json")


def test_a_real_limit_on_file_sizes(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
        with pytest.raises(TrajectoryFileError, match="File too large"):
            write_trajectories(tmp_path / "x", [SPEC], ["lift"], map(demonstration, range(9)), WHY)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    write_trajectories(tmp_path / "x", [SPEC], ["lift"], map(demonstration, range(9)), WHY)
    verify_hashes(tmp_path / "x")


def test_a_thread_that_cannot_write_says_so_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """As TensorBoard's, whose traceback would fill the screen."""

    def fail(error: Exception) -> None:
        raise error

    before = threading.excepthook
    tell_of_threads()
    try:
        for error in (OSError(28, "No space left on device"), ValueError("a fault of the program")):
            thread = threading.Thread(target=fail, args=(error,))
            thread.start()
            thread.join()
    finally:
        threading.excepthook = before
    first, *rest = capsys.readouterr().err.splitlines()
    assert first == "what a thread was writing is incomplete: [Errno 28] No space left on device"
    assert rest[-1] == "ValueError: a fault of the program"
