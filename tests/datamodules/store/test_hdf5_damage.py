from __future__ import annotations

import multiprocessing
import pickle
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from demonstrations import ARM, SPECS, TASKS, WHY, assert_equal, demonstration, demonstrations
from hypothesis import given, settings
from hypothesis import strategies as st

from datamodules.errors import TrajectoryFileError
from datamodules.store import recording
from datamodules.store.schema import LATEST_VERSION
from datamodules.store.writer import (
    FORMAT,
    TrajectoryFile,
    add_trajectories,
    verify_hashes,
    write_trajectories,
)
from datamodules.types import Trajectory


def everything(path: Path) -> list[Trajectory]:
    with TrajectoryFile.open(path) as file:
        return [file.trajectory(s.name, e) for s in file.domains for e in range(len(file.episodes(s.name).task))]


# -- damage ----------------------------------------------------------------------------------------------


def set_attribute(name: str, value: object, path: Path) -> None:
    with h5py.File(path, "a") as file:
        file.attrs[name] = value


def delete(place: str, path: Path) -> None:
    with h5py.File(path, "a") as file:
        parent, _, name = place.rpartition("/")
        del file[parent][name]


def put(place: str, array: np.ndarray, path: Path) -> None:
    delete(place, path)
    with h5py.File(path, "a") as file:
        file[place] = array


def forget_completion(path: Path) -> None:
    with h5py.File(path, "a") as file:
        del file.attrs["complete"]


def cut(share: float, path: Path) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (Path.unlink, "no such file"),
        (partial(cut, 0.0), "the file is empty"),
        (partial(cut, 0.3), "cannot be read as HDF5"),
        (partial(cut, 0.999), "cannot be read as HDF5"),
        (lambda path: path.write_text("a,b\n1,2\n" * 99), "cannot be read as HDF5"),
        (partial(set_attribute, "format", "minari"), f"format 'minari'; expected '{FORMAT}'"),
        (partial(set_attribute, "format_version", "2.0"), f"format version '2.0'; expected '{LATEST_VERSION}'"),
        (partial(set_attribute, "complete", False), "never finished"),
        (forget_completion, "never finished"),
        (partial(set_attribute, "provenance", "{}"), "provenance that do not match their hash"),
        (partial(set_attribute, "domains", '["arm"]'), "do not match their hash"),
        (partial(set_attribute, "domains", '["leg"]'), "domain 'leg': found no group of that name"),
        (partial(set_attribute, "content_sha256", "{"), "cannot be read as HDF5"),
        (partial(delete, "/domains/arm/actions"), "no array /domains/arm/actions"),
        (partial(delete, "/domains/arm/obs/pos"), "no array /domains/arm/obs/pos"),
        (partial(delete, "/domains/arm/episodes"), "no array /domains/arm/episodes/task_id"),
        (
            partial(put, "/domains/arm/actions", np.zeros((3, 4), np.float32)),
            r"/domains/arm/actions of shape \(3, 4\), type float32; expected shape \(27, 4\), type float32",
        ),
        (partial(put, "/domains/arm/obs/grip", np.zeros((27, 1))), r"no array|cannot be read"),
        (partial(put, "/domains/arm/episodes/offset", np.arange(7) - 1), "expected 0 first, then strictly rising"),
        (partial(put, "/domains/arm/episodes/offset", np.array([0, 9, 9, 12, 13, 14, 27])), "strictly rising"),
        (
            partial(put, "/domains/arm/episodes/offset", np.arange(6)),
            r"shape \(6,\), type int64; expected shape \(7,\)",
        ),
        (partial(delete, "/domains/arm/episodes/last"), "no array /domains/arm/episodes/last"),
        (
            partial(put, "/domains/arm/episodes/last", np.array([-1, 27, -1, 29, -1, 28])),
            r"episodes/last \[27, 29, 28\]…; expected -1, or 27 and the rows after it in turn",
        ),
        (
            partial(put, "/domains/arm/episodes/last", np.array([-1, 27, -1, 28, -1, -1])),
            r"/domains/arm/obs/pos of shape \(30, 3\), type float32; expected shape \(29, 3\), type float32",
        ),
        (
            partial(set_attribute, "format_version", "1.0"),
            r"of shape \(30, 3\), type float32; expected shape \(27, 3\)",
        ),
        (partial(put, "/domains/arm/episodes/task_id", np.full(6, 3, np.int32)), "a number outside 0…2"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(path, damage, message):
    damage(path)
    with pytest.raises(TrajectoryFileError, match=message) as caught:
        TrajectoryFile.open(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["/domains/arm/actions", "/domains/camera/obs/joints", "/domains/arm/episodes/seed"])
@pytest.mark.parametrize("first", [True, False])
def test_a_flipped_bit_is_found(path, place, first):
    with h5py.File(path) as file:
        start = file[place].id.get_offset() + (0 if first else file[place].nbytes - file[place].dtype.itemsize)
    content = bytearray(path.read_bytes())
    content[start] ^= 1
    path.write_bytes(content)
    with pytest.raises(TrajectoryFileError, match=rf"values of {place} that do not match their hash"):
        verify_hashes(path)


@settings(max_examples=50, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True), mask=st.integers(1, 255))
def test_any_flipped_byte_is_refused_or_harmless(tmp_path_factory, share, mask):
    folder = tmp_path_factory.getbasetemp()
    original, copy = folder / "original.hdf5", folder / "flipped.hdf5"
    if not original.exists():
        write_trajectories(original, SPECS, TASKS, demonstrations(), WHY)
    content = bytearray(original.read_bytes())
    content[int(share * len(content))] ^= mask
    copy.write_bytes(content)
    try:
        verify_hashes(copy)
    except TrajectoryFileError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    for one, other in zip(everything(copy), everything(original), strict=True):
        assert_equal(one, other)


# -- atomicity -------------------------------------------------------------------------------------------


def test_a_failed_growth_leaves_the_old_file(path, monkeypatch):
    before = path.read_bytes()
    monkeypatch.setattr(recording, "verify_hashes", partial(_fail, path.parent))
    with pytest.raises(KeyboardInterrupt):
        add_trajectories(path, SPECS, TASKS, [demonstration(ARM, "lift", 77)], WHY)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def _fail(folder: Path, temporary: Path) -> None:
    assert temporary.parent == folder
    assert temporary.exists()
    raise KeyboardInterrupt


def test_a_failing_source_of_demonstrations_leaves_nothing(tmp_path):
    def broken():
        yield demonstration(ARM, "lift", 1)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_trajectories(tmp_path / "x", SPECS, TASKS, broken(), WHY)
    assert list(tmp_path.iterdir()) == []


WRITER = f"""
import os, resource, signal, sys
sys.path[:0] = {sys.path!r}
from datamodules.store import recording
from datamodules.errors import TrajectoryFileError
from datamodules.store.writer import add_trajectories
from demonstrations import ARM, TASKS, demonstration
mode, path = sys.argv[1:]
if mode == "full":
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
else:
    recording.verify_hashes = lambda temporary: os.kill(os.getpid(), signal.SIGKILL)
try:
    add_trajectories(path, [ARM], TASKS, [demonstration(ARM, "lift", 99, 9_000)], {{}})
except TrajectoryFileError as error:
    print(error)
    sys.exit(2)
"""


def _run(mode: str, path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WRITER, mode, str(path)], capture_output=True, text=True, check=False)


def test_a_full_disk_leaves_the_old_file(path):
    before = path.read_bytes()
    done = _run("full", path)
    assert re.fullmatch(rf"{path}: cannot be written \(.*\); expected a folder with free space: .*\n", done.stdout), (
        done
    )
    assert done.returncode == 2
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_killed_writer_leaves_the_old_file_and_the_next_one_cleans_up(path):
    before = path.read_bytes()
    assert _run("kill", path).returncode == -9
    assert path.read_bytes() == before
    assert len(list(path.parent.iterdir())) == 2
    add_trajectories(path, SPECS, TASKS, [demonstration(ARM, "lift", 99)], WHY)
    assert list(path.parent.iterdir()) == [path]
    assert sum(sum(tasks.values()) for tasks in TrajectoryFile.open(path).counts().values()) == 13


def _add_one(path: Path, seed: int) -> None:
    add_trajectories(path, SPECS, TASKS, [demonstration(ARM, "lift", seed)], WHY)


def test_two_writers_lose_nothing(path):
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_add_one, args=(path, seed)) for seed in range(10, 14)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    with TrajectoryFile.open(path) as file:
        assert set(range(10, 14)) <= set(file.episodes("arm").seed)


# -- other processes -------------------------------------------------------------------------------------


def test_an_open_file_can_be_pickled(path):
    with TrajectoryFile.open(path) as file:
        copy = pickle.loads(pickle.dumps(file))
        assert copy.counts() == file.counts()
        assert_equal(copy.trajectory("camera", 3), file.trajectory("camera", 3))
        copy.close()


def _send(file: TrajectoryFile, pipe) -> None:
    pipe.send(file.read("arm", [2]).state)


def test_a_forked_process_opens_the_file_for_itself(path):
    with TrajectoryFile.open(path) as file:
        wanted = file.read("arm", [2]).state
        here, there = multiprocessing.Pipe()
        child = multiprocessing.get_context("fork").Process(target=_send, args=(file, there))
        child.start()
        np.testing.assert_array_equal(here.recv(), wanted)
        child.join()
        np.testing.assert_array_equal(file.read("arm", [2]).state, wanted)


def test_a_closed_file_opens_again_unless_it_was_replaced(path):
    file = TrajectoryFile.open(path)
    file.close()
    assert len(file.read("arm").actions) == 27
    file.close()
    add_trajectories(path, SPECS, TASKS, [demonstration(ARM, "lift", 99)], WHY)
    with pytest.raises(TrajectoryFileError, match="the file was replaced while in use"):
        file.read("arm")
