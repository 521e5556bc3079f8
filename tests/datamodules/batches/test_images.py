"""Images in memory and images in their file are the same to everyone who asks for them."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import large_file
import numpy as np
import pytest
import seen
import torch
from demonstrations import ARM, CAMERA, TASKS, demonstrations

from datamodules.batches.images import ImageFile, stored_images
from datamodules.errors import TrajectoryFileError, UserError
from datamodules.store.writer import TrajectoryFile, write_trajectories
from datamodules.types import Batch, BatchSpec, Observation

CHOSEN, KEY = np.array([1, 3, 4]), CAMERA.observation[0]


@pytest.fixture(scope="module")
def seen_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("seen") / "seen.hdf5"
    seen.write(path)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Iterator[TrajectoryFile]:
    write_trajectories(tmp_path / "d.hdf5", [ARM, CAMERA], TASKS, demonstrations(2), {})
    with TrajectoryFile.open(tmp_path / "d.hdf5") as opened:
        yield opened


def in_memory(file: TrajectoryFile) -> np.ndarray:
    image = file.read("camera", CHOSEN).images["image"]
    assert image is not None
    return image


# -- rows of the file --------------------------------------------------------------------------------


def test_rows_of_episodes_lie_end_to_end_and_last_observations_behind_them(file: TrajectoryFile) -> None:
    assert file.episodes("camera").offset.tolist() == [0, 4, 9, 13, 18, 22, 27]
    assert file.episodes("camera").last.tolist() == [-1, 27, -1, 28, -1, 29]
    assert file.rows("camera", [3, 1, 0]).tolist() == [13, 14, 15, 16, 17, 4, 5, 6, 7, 8, 0, 1, 2, 3, 28, 27]
    assert file.rows("camera", [0]).tolist() == [0, 1, 2, 3]
    assert file.rows("camera").tolist() == list(range(30))
    with pytest.raises(UserError, match="has episodes 0 to 5; asked for 6"):
        file.rows("camera", [6])


def test_images_of_episodes_and_of_ranges(file: TrajectoryFile) -> None:
    everything = file.images("camera")
    np.testing.assert_array_equal(everything[file.rows("camera", CHOSEN)], in_memory(file))
    np.testing.assert_array_equal(file.image_range("camera", 8, 16), everything[8:16])
    np.testing.assert_array_equal(file.image_range("camera", 24, 32), everything[24:])
    assert file.image_block("camera") == 8


def test_a_domain_without_a_camera_has_no_images(file: TrajectoryFile) -> None:
    with pytest.raises(UserError, match="domain 'arm' has no camera; ask for its state alone"):
        file.images("arm")
    assert stored_images(file, {"arm": CHOSEN}, 1.0) == {"arm": {}}


# -- images that stay in their file ------------------------------------------------------------------


@pytest.mark.parametrize("rows", [[0], [5, 0, 15, 5, 13], [*range(16)], [-1, 2]])
def test_an_image_file_answers_as_a_tensor_would(file: TrajectoryFile, rows: list[int]) -> None:
    whole = torch.from_numpy(in_memory(file))
    images = ImageFile(file, "camera", KEY, CHOSEN, kept_bytes=0)
    assert images.shape == whole.shape == (16, 4, 5, 3)
    assert len(images) == 16
    for index in (np.array(rows), torch.tensor(rows)):
        assert torch.equal(images[index], whole[index])
    for part in (slice(2, 9), slice(None), slice(12, 40)):
        assert torch.equal(images[part], whole[part])


@pytest.mark.parametrize("blocks", [0, 1, 2, 9])
def test_no_more_is_kept_than_was_allowed_and_that_is_read_once(
    file: TrajectoryFile, blocks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[int] = []
    original = TrajectoryFile.image_range

    def counted(self: TrajectoryFile, domain: str, start: int, stop: int, camera: str) -> np.ndarray:
        reads.append(start // 8)
        return original(self, domain, start, stop, camera)

    monkeypatch.setattr(TrajectoryFile, "image_range", counted)
    size = 8 * 4 * 5 * 3
    images = ImageFile(file, "camera", KEY, np.arange(6), kept_bytes=blocks * size)
    whole = torch.from_numpy(file.images("camera"))
    for seed in range(4):
        rows = torch.randperm(30, generator=torch.Generator().manual_seed(seed))
        assert torch.equal(images[rows], whole[rows])
        assert sum(block.nbytes for block in images.blocks.values()) == images.held_bytes <= blocks * size
    kept = sorted(images.blocks)
    assert len(kept) == min(blocks, 4)
    assert [reads.count(block) for block in range(4)] == [1 if block in kept else 4 for block in range(4)]


def test_an_image_file_can_be_closed_and_sent_to_another_process(file: TrajectoryFile) -> None:
    images, whole = ImageFile(file, "camera", KEY, CHOSEN, 10**6), torch.from_numpy(in_memory(file))
    file.close()
    assert torch.equal(pickle.loads(pickle.dumps(images))[slice(None)], whole)
    assert torch.equal(images[slice(None)], whole)


def test_a_file_that_was_replaced_while_in_use_is_noticed(file: TrajectoryFile) -> None:
    images = ImageFile(file, "camera", KEY, CHOSEN, 0)
    file.close()
    file.path.unlink()
    write_trajectories(file.path, [ARM, CAMERA], TASKS, demonstrations(3), {})
    with pytest.raises(TrajectoryFileError, match="the file was replaced while in use; start again"):
        images[[0]]


def test_memory_is_shared_out_by_size_and_images_that_fit_are_tensors(seen_file: Path) -> None:
    with TrajectoryFile.open(seen_file) as file:
        episodes = {"left": np.arange(18), "right": np.arange(9)}
        rows = {domain: len(file.rows(domain, chosen)) for domain, chosen in episodes.items()}
        needed = sum(rows.values()) * 9 * 9 * 3
        fits = {d: x["camera"] for d, x in stored_images(file, episodes, needed / 2**30).items()}
        assert all(isinstance(images, torch.Tensor) for images in fits.values())
        short = {d: x["camera"] for d, x in stored_images(file, episodes, (needed - 1) / 2**30).items()}
        for domain, images in short.items():
            assert isinstance(images, ImageFile)
            assert images.kept_bytes == (needed - 1) * rows[domain] // sum(rows.values())
            assert torch.equal(images[slice(None)], fits[domain])


# -- batches -----------------------------------------------------------------------------------------


def contents(batch: Batch) -> list[torch.Tensor]:
    steps = [t for s in batch.steps.values() for t in (*parts(s.observation), s.action, s.task, s.row)]
    steps += [t for s in batch.steps.values() if s.next_observation for t in parts(s.next_observation)]
    return [*steps, *(t for s in batch.pairs.values() for t in (*parts(s.observation), s.frame, s.mask))]


def parts(observation: Observation[torch.Tensor]) -> list[torch.Tensor]:
    return [observation.state, *observation.images.values()]


@pytest.mark.parametrize("place", [seen.ON_DISK, seen.HALF])
def test_batches_are_the_same_wherever_images_are(seen_file: Path, place: float) -> None:
    one, other = seen.data_module(seen_file), seen.data_module(seen_file, place)
    assert isinstance(one.datasets["left"].observation.images["camera"], torch.Tensor)
    assert isinstance(other.datasets["left"].observation.images["camera"], ImageFile)
    for batch_spec in (BatchSpec(pairs="thinned"), BatchSpec("mix"), BatchSpec(next_observation=True)):
        for first, second in zip(one.loader(batch_spec), other.loader(batch_spec), strict=True):
            assert len(contents(first)) == len(contents(second)) > 0
            assert all(torch.equal(a, b) for a, b in zip(contents(first), contents(second), strict=True))
    held_out = zip(one.val_dataloader(), other.val_dataloader(), strict=True)
    assert all(torch.equal(a, b) for x, y in held_out for a, b in zip(contents(x), contents(y), strict=True))


def test_batches_hold_the_images_that_were_recorded(seen_file: Path) -> None:
    data = seen.data_module(seen_file, seen.HALF)
    recorded = {
        tuple(state.tolist()): image
        for t in seen.demonstrations(6)
        for state, image in zip(t.observation.state, t.observation.images["camera"], strict=True)
    }
    for batch in data.loader(BatchSpec(pairs="thinned", next_observation=True)):
        parts = [part.observation for part in (*batch.steps.values(), *batch.pairs.values())]
        parts += [steps.next_observation for steps in batch.steps.values() if steps.next_observation is not None]
        assert len(parts) == 3 * len(batch.steps)
        for part in parts:
            assert part.images["camera"].dtype is torch.uint8
            for state, image in zip(part.state, part.images["camera"], strict=True):
                np.testing.assert_array_equal(image, recorded[tuple(state.tolist())])


def test_the_fingerprint_is_that_of_the_values_wherever_they_are(seen_file: Path) -> None:
    prints = {seen.data_module(seen_file, place).fingerprint for place in (seen.IN_MEMORY, seen.ON_DISK, seen.HALF)}
    assert len(prints) == 1


@pytest.mark.parametrize("row", [0, -1])
def test_one_other_pixel_is_another_fingerprint(seen_file: Path, tmp_path: Path, row: int) -> None:
    changed = seen.demonstrations(6)[0]
    image = changed.observation.images["camera"].copy()
    image[row, 0, 0, 0] ^= 1
    again = replace(changed, observation=Observation(changed.observation.state, {"camera": image}), success=True)
    specs = [domain.simulator.spec(name) for name, domain in seen.domains().items()]
    write_trajectories(tmp_path / "other.hdf5", specs, seen.TASKS, [again, *seen.demonstrations(6)[1:]], {})
    prints = {seen.data_module(path, 0).fingerprint for path in (seen_file, tmp_path / "other.hdf5")}
    assert len(prints) == 2


def test_who_does_not_look_gets_no_images(seen_file: Path) -> None:
    data = seen.data_module(seen_file, seen.ON_DISK)
    blind = [s.observation.images for b in data.loader(BatchSpec("mix", images=False)) for s in b.steps.values()]
    assert blind
    assert all(images == {} for images in blind)
    images = data.datasets["left"].observation.images["camera"]
    assert isinstance(images, ImageFile)
    assert images.held_bytes == 0


# -- a file larger than memory -----------------------------------------------------------------------


def test_a_file_larger_than_memory_gives_its_batches_from_disk(tmp_path: Path) -> None:
    large_file.write(tmp_path / "large.hdf5")
    context = multiprocessing.get_context("spawn")
    answers: multiprocessing.queues.Queue[str] = context.Queue()
    child = context.Process(target=large_file.read_within, args=(tmp_path / "large.hdf5", answers))
    child.start()
    in_memory, on_disk = answers.get(timeout=280), answers.get(timeout=280)
    child.join()
    assert in_memory.startswith("MemoryError")
    assert on_disk == large_file.fingerprint_and_shown(tmp_path / "large.hdf5", 4.0)
    assert on_disk.endswith(" 16 parts, 0.0 off")
