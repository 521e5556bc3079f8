"""Decoded images that runs share: one file for all, never believed, and done without where nothing can be written."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import seen
import torch
from command import processes
from torch import Tensor

from datamodules.batches import shared
from datamodules.batches.images import Images, stored_images
from datamodules.batches.shared import SharedImages, images_folder
from datamodules.store.reader import TrajectoryFile
from datamodules.store.writer import add_trajectories, write_trajectories
from datamodules.types import BatchSpec, DomainSpec, Observation, ObservationKey, Trajectory

ARM = DomainSpec("arm", (ObservationKey("joints", (3,)), ObservationKey("view", (8, 6, 3), "image")), 2, 10.0)
CHOSEN = np.array([1, 2, 4])


def demonstration(seed: int, steps: int = 5) -> Trajectory:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (steps + 1, 8, 6, 3), dtype=np.uint8)
    seen = Observation(rng.normal(size=(steps + 1, 3)).astype(np.float32), {"view": image})
    return Trajectory("arm", "lift", seen, rng.uniform(-1, 1, (steps, 2)).astype(np.float32), seed, True)


@pytest.fixture(autouse=True)
def _few_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared, "LEAST_BYTES", 1)
    monkeypatch.setattr(shared, "ROWS", 4)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_trajectories(tmp_path / "d.hdf5", [ARM], ["lift"], map(demonstration, range(5)), {})
    return tmp_path / "d.hdf5"


def images(path: Path, episodes: np.ndarray = CHOSEN, memory: float = 1.0) -> Images:
    with TrajectoryFile.open(path) as file:
        return stored_images(file, {"arm": episodes}, memory)["arm"]["view"]


def expected(path: Path) -> Tensor:
    with TrajectoryFile.open(path) as file:
        return torch.from_numpy(file.images("arm", CHOSEN))


def decoded(path: Path) -> Path:
    (found,) = images_folder(path).iterdir()
    return found


def check_shared(path: Path) -> None:
    found = images(path)
    assert isinstance(found, SharedImages)
    assert torch.equal(found[:], expected(path))


def check_own(path: Path) -> None:
    found = images(path)
    assert isinstance(found, Tensor)
    assert torch.equal(found, expected(path))


ROWS = [[0], [5, 0, 15, 5, 13], [*range(18)], [-1, 2]]


@pytest.mark.parametrize(
    "rows", [*ROWS, *map(np.array, ROWS), *map(torch.tensor, ROWS), np.s_[3:9], np.s_[:0]], ids=str
)
def test_shared_images_answer_as_a_tensor_would(path: Path, rows: object) -> None:
    found, own = images(path), expected(path)
    assert isinstance(found, SharedImages)
    assert (len(found), found.shape, found.nbytes) == (len(own), own.shape, own.nbytes)
    assert torch.equal(found[rows], own[rows])  # type: ignore[index]
    assert found.to(torch.device("cpu")) is found
    assert found.to(torch.device("meta")).shape == own.shape


def test_a_second_run_maps_the_same_file_and_decodes_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_shared(path)
    before = decoded(path).stat()
    with monkeypatch.context() as patch:
        patch.setattr(TrajectoryFile, "image_range", lambda *_: pytest.fail("decoded again"))
        check_shared(path)
    after = decoded(path).stat()
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)


def test_batches_and_fingerprint_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen.write(tmp_path / "seen.hdf5")
    together, alone = (seen.data_module(tmp_path / "seen.hdf5") for _ in range(2))
    batches = [*together.loader(BatchSpec())]
    assert all(isinstance(x, SharedImages) for d in together.datasets.values() for x in d.observation.images.values())
    monkeypatch.setattr(shared, "LEAST_BYTES", 2**40)
    assert all(steps.observation.images for steps in batches[0].steps.values())
    for one, other in zip(batches, alone.loader(BatchSpec()), strict=True):
        for domain, steps in one.steps.items():
            for camera, found in steps.observation.images.items():
                assert torch.equal(found, other.steps[domain].observation.images[camera])
    assert all(isinstance(x, Tensor) for d in alone.datasets.values() for x in d.observation.images.values())
    assert together.fingerprint == alone.fingerprint


def _map(path: Path, told: Path) -> None:
    shared.LEAST_BYTES = 1
    found = images(path)
    assert isinstance(found, SharedImages)
    mapped = [line.split() for line in Path("/proc/self/maps").read_text().splitlines() if ".images/" in line]
    (told / str(os.getpid())).write_text(" ".join(mapped[0][index] for index in (3, 4)))  # device and inode


def test_processes_that_begin_at_once_share_one_file(path: Path, tmp_path: Path) -> None:
    told = tmp_path / "told"
    told.mkdir()
    several = [processes.Process(target=_map, args=(path, told)) for _ in range(3)]
    for process in several:
        process.start()
    for process in several:
        process.join(60)
        assert process.exitcode == 0
    assert len({file.read_text() for file in told.iterdir()}) == 1
    assert len([*told.iterdir()]) == 3
    decoded(path)


def test_nobody_s_writing_reaches_the_file(path: Path) -> None:
    found = images(path)
    assert isinstance(found, SharedImages)
    found.stored.zero_()
    check_shared(path)


def _change(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "a bit": _change,
    "half": lambda path: os.truncate(path, path.stat().st_size // 2),
    "empty": lambda path: os.truncate(path, 0),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"0"),
    "no file": Path.unlink,
    "dead link": lambda path: (path.unlink(), path.symlink_to("nowhere")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_decoded_anew(path: Path, damage: str) -> None:
    check_shared(path)
    DAMAGES[damage](decoded(path))
    check_shared(path)
    assert decoded(path).stat().st_size == images_bytes(path)


def images_bytes(path: Path) -> int:
    with TrajectoryFile.open(path) as file:
        return int(np.prod(file.image_shape("arm")))


def test_a_run_keeps_its_images_when_the_demonstrations_are_replaced(path: Path) -> None:
    found, before = images(path), expected(path)
    old = decoded(path)
    path.unlink()
    write_trajectories(path, [ARM], ["lift"], map(demonstration, range(10, 15)), {})
    check_shared(path)
    assert not old.exists()
    assert torch.equal(found[:], before)


def test_more_demonstrations_are_decoded_anew(path: Path) -> None:
    check_shared(path)
    old = decoded(path)
    add_trajectories(path, [ARM], ["lift"], [demonstration(9)], {})
    check_shared(path)
    assert not old.exists()


def _folder_taken(path: Path, _: pytest.MonkeyPatch) -> None:
    images_folder(path).write_text("mine")


def _refusing(call: str, number: int) -> Callable[[Path, pytest.MonkeyPatch], None]:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    return lambda _, patch: patch.setattr(os, call, refuse)


def _full(_: Path, patch: pytest.MonkeyPatch) -> None:
    def half(self: TrajectoryFile, domain: str, start: int, *_: object) -> np.ndarray:
        if start:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return np.zeros((4, 8, 6, 3), np.uint8)

    patch.setattr(TrajectoryFile, "image_range", half)


REFUSALS = {
    "a file in the folder's place": _folder_taken,
    "a folder that takes nothing": _refusing("mkdir", errno.EROFS),
    "a disk that is full": _full,
    "a disk that is full at last": _refusing("fsync", errno.ENOSPC),
    "a quota": _refusing("replace", errno.EDQUOT),
}


@pytest.mark.parametrize("refusal", REFUSALS)
def test_where_nothing_can_be_written_each_run_has_its_own(
    path: Path, monkeypatch: pytest.MonkeyPatch, refusal: str
) -> None:
    with monkeypatch.context() as patch:
        REFUSALS[refusal](path, patch)
        check_own(path)
    if images_folder(path).is_dir():
        assert [*images_folder(path).iterdir()] == []


def test_values_that_are_not_those_of_the_hash_are_not_shared(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrajectoryFile, "image_hash", lambda *_: "0" * 64)
    check_own(path)
    monkeypatch.setattr(TrajectoryFile, "image_hash", lambda *_: None)
    check_own(path)


def test_few_images_and_few_of_many_are_not_decoded_for_all(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(images(path, np.array([3])), Tensor)
    monkeypatch.setattr(shared, "LEAST_BYTES", images_bytes(path) + 1)
    check_own(path)
    assert not images_folder(path).exists()


def test_images_that_do_not_fit_stay_in_their_file(path: Path) -> None:
    assert not isinstance(images(path, memory=0.0), Tensor | SharedImages)
    assert not images_folder(path).exists()
