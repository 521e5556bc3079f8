"""Demonstrations → the groups and arrays of a trajectory file."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, cast

import h5py
import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.store.atomic import replacing
from datamodules.store.patient import PatientFile
from datamodules.store.reader import TrajectoryFile, verify_hashes
from datamodules.store.schema import HEADER, Header, check_spec, check_tasks, digest, write_header
from datamodules.types import DomainSpec, ObservationKey, Trajectory

IMAGE_CHUNK = 8
"""Frames in a compressed block: few, to read single frames; enough to profit from a scene that stands still."""
ROW_CHUNK = 1024
GZIP_LEVEL = 1


class Episode(NamedTuple):
    """An episode on its way into a file; its images stay where they are until they are written."""

    task: str
    seed: int
    success: bool
    state: np.ndarray  # ``(T + 1, O)`` float32; ``(T, O)`` if nobody knows what was seen last
    actions: np.ndarray  # ``(T, A)`` float32
    cameras: tuple[str, ...]
    image: Callable[[str], np.ndarray]  # Gives a camera's ``(T + 1, H, W, C)`` or ``(T, H, W, C)`` uint8


def plain_json(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Copy provenance as JSON gives it back; a :class:`TrajectoryFileError` says if JSON cannot hold it."""
    try:
        return cast("dict[str, Any]", json.loads(json.dumps(dict(provenance), allow_nan=False)))
    except (TypeError, ValueError) as error:
        raise TrajectoryFileError(f"provenance cannot be stored ({error}); expected what JSON can hold") from error


def episodes_by_domain(
    trajectories: Iterable[Trajectory], domains: Sequence[DomainSpec], tasks: Sequence[str]
) -> dict[str, list[Episode]]:
    """Check demonstrations, states ``(T + 1, O)`` or ``(T, O)``, actions ``(T, A)``, and group them by domain.

    Raises:
        TrajectoryFileError: Naming the first domain, task, or demonstration (with seed and key) that cannot be stored.
    """
    specs = {spec.name: spec for spec in domains}
    for spec in domains:
        check_spec(spec, f"domain {spec.name!r}")
    check_tasks(tasks, "tasks")
    if len(specs) < len(domains):
        raise TrajectoryFileError(f"domains {', '.join(spec.name for spec in domains)}; expected every name once")
    episodes: dict[str, list[Episode]] = {name: [] for name in specs}
    for trajectory in trajectories:
        _check_names(trajectory, specs, tasks)
        episodes[trajectory.domain].append(_episode(trajectory, specs[trajectory.domain]))
    return episodes


class Output(NamedTuple):
    """An HDF5 file that is being written."""

    file: h5py.File
    disk: PatientFile  # Asked after each large piece whether all of it found room
    vectors: bool  # Whether vectors are compressed
    images: Literal["gzip", "lzf"]  # How images are compressed; lzf is several times as fast and takes more room


def stored_episodes(
    file: TrajectoryFile, domain: str, opened: Callable[[], TrajectoryFile] | None = None
) -> list[Episode]:
    """Episodes of a domain, states ``(T + 1, O)``, actions ``(T, A)``; none if the file does not know the domain.

    Their images are read when they are asked for, from the file that ``opened`` gives, or from this one.
    """
    if domain not in {spec.name for spec in file.domains}:
        return []
    (offset, task, seed, success, last), arrays = file.episodes(domain), file.read(domain, images=False)
    episodes, giver, cameras = [], opened or (lambda: file), tuple(key.name for key in file.spec(domain).image_keys)
    for number, (start, stop) in enumerate(itertools.pairwise(offset)):
        rows, image = np.append(np.arange(start, stop), last[number]), partial(_image, giver, domain, number)
        told = str(task[number]), int(seed[number]), bool(success[number])
        episodes.append(Episode(*told, arrays.state[rows[rows >= 0]], arrays.actions[start:stop], cameras, image))
    return episodes


def write_file(
    path: Path,
    header: Header,
    episodes: Mapping[str, Sequence[Episode]],
    compress: bool = False,
    images: Literal["gzip", "lzf"] = "gzip",
) -> None:
    """Write a file beside ``path``, read it back, and put it in its place; call it with the folder locked.

    The episodes of each domain, states ``(T + 1, O)``, actions ``(T, A)``, may come in any order.

    Raises:
        TrajectoryFileError: If the disk is full or the folder may not be written to; ``path`` stays as it was.
    """
    with _writable(path, _most_bytes(header, episodes)), replacing(path) as temporary:
        with closing(PatientFile(temporary)) as disk:
            # The bounds keep files readable for HDF5 1.10.
            with h5py.File(disk, "w", libver=("earliest", "v110")) as file:
                _write(Output(file, disk, compress, images), header, episodes)
            disk.check()
        verify_hashes(temporary)


def _write(output: Output, header: Header, episodes: Mapping[str, Sequence[Episode]]) -> None:
    write_header(output.file, header)
    hashes = {HEADER: header.digest()}
    for spec in header.domains:
        ordered = sorted(episodes.get(spec.name, ()), key=lambda e: (header.tasks.index(e.task), e.seed))
        hashes |= _write_domain(output, spec, header.tasks, ordered)
    output.file.attrs["content_sha256"] = json.dumps(hashes, sort_keys=True)
    output.file.attrs["complete"] = True


def _most_bytes(header: Header, episodes: Mapping[str, Sequence[Episode]]) -> int:
    """Bytes that the arrays take if nothing in them can be compressed."""
    frames = {spec.name: sum(math.prod(key.shape) for key in spec.image_keys) for spec in header.domains}
    each = ((e, frames[name]) for name, found in episodes.items() for e in found)
    return sum(e.state.nbytes + e.actions.nbytes + len(e.state) * frame for e, frame in each)


@contextmanager
def _writable(path: Path, most_bytes: int) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or " ".join(str(error).split())
        expected = f"expected a folder with free space: make room for {most_bytes} bytes or choose another"
        raise TrajectoryFileError(f"{path}: cannot be written ({reason}); {expected}") from error


def _write_domain(
    output: Output, spec: DomainSpec, tasks: Sequence[str], episodes: Sequence[Episode]
) -> dict[str, str]:
    offset = np.cumsum([0, *(len(e.actions) for e in episodes)], dtype=np.int64)
    known = np.array([len(e.state) > len(e.actions) for e in episodes], np.bool_)
    seen = [*(e.state[: len(e.actions)] for e in episodes), *(e.state[len(e.actions) :] for e in episodes)]
    state = np.concatenate([np.empty((0, spec.state_size), np.float32), *seen])
    arrays = {f"obs/{key.name}": state[:, spec.columns([key.name])] for key in spec.state_keys} | {
        "actions": np.concatenate([np.empty((0, spec.action_size), np.float32), *(e.actions for e in episodes)]),
        "episodes/offset": offset,
        "episodes/last": np.where(known, offset[-1] + np.cumsum(known) - 1, -1).astype(np.int64),
        "episodes/task_id": np.array([tasks.index(e.task) for e in episodes], np.int32),
        "episodes/seed": np.array([e.seed for e in episodes], np.int64),
        "episodes/success": np.array([e.success for e in episodes], np.bool_),
    }
    place = f"/domains/{spec.name}"
    hashes = {f"{place}/{name}": _write_array(output, f"{place}/{name}", array) for name, array in arrays.items()}
    for camera in spec.image_keys:
        hashes[f"{place}/obs/{camera.name}"] = _write_images(output, place, camera, len(state), episodes)
    for key in spec.observation:
        written = output.file[f"{place}/obs/{key.name}"]
        written.attrs.update({"kind": key.kind, "unit": key.unit, "shape": key.shape})
    return hashes


def _write_array(output: Output, place: str, array: np.ndarray) -> str:
    compression = _gzip(ROW_CHUNK, array.shape) if output.vectors and len(array) else {}
    output.file.create_dataset(place, data=array, **compression)
    output.disk.check()
    return digest(array.dtype, array.shape, [array])


def _gzip(rows: int, shape: tuple[int, ...]) -> dict[str, Any]:
    return {"chunks": _chunk(rows, shape), "compression": "gzip", "compression_opts": GZIP_LEVEL}


def _chunk(rows: int, shape: tuple[int, ...]) -> tuple[int, ...]:
    return (min(rows, shape[0]), *shape[1:])


def _write_images(output: Output, domain: str, key: ObservationKey, rows: int, episodes: Sequence[Episode]) -> str:
    place, shape = f"{domain}/obs/{key.name}", (rows, *key.shape)
    if not rows:
        return _write_array(output, place, np.empty(shape, np.uint8))
    lzf = {"chunks": _chunk(IMAGE_CHUNK, shape), "compression": "lzf"}
    storage = _gzip(IMAGE_CHUNK, shape) if output.images == "gzip" else lzf
    array = output.file.create_dataset(place, shape, np.uint8, **storage)
    return digest(array.dtype, shape, _written(array, key.name, episodes, output.disk))


def _written(array: h5py.Dataset, camera: str, episodes: Iterable[Episode], disk: PatientFile) -> Iterator[np.ndarray]:
    start, last = 0, [np.empty((0, *array.shape[1:]), array.dtype)]
    for episode in episodes:
        images, steps = episode.image(camera), len(episode.actions)
        array[start : start + steps] = images[:steps]
        disk.check()
        start += steps
        last.append(images[steps:].copy())  # a view would keep all images in memory
        yield images[:steps]
    ends = np.concatenate(last)
    array[start:] = ends
    yield ends


def _image(opened: Callable[[], TrajectoryFile], domain: str, episode: int, camera: str) -> np.ndarray:
    return opened().images(domain, [episode], camera)


def _check_names(trajectory: Trajectory, specs: Mapping[str, DomainSpec], tasks: Sequence[str]) -> None:
    if trajectory.domain not in specs:
        _refuse(trajectory, "an unknown domain", f"one of {', '.join(specs)}", "name it among the domains")
    if trajectory.task not in tasks:
        _refuse(trajectory, "an unknown task", f"one of {', '.join(tasks)}", "name it among the tasks")


def _episode(trajectory: Trajectory, spec: DomainSpec) -> Episode:
    state, actions = (np.asarray(array, np.float32) for array in (trajectory.observation.state, trajectory.actions))
    images = trajectory.observation.images
    steps, seen = len(trajectory), len(trajectory) + trajectory.last_known
    if state.shape != (seen, spec.state_size):
        _refuse(trajectory, f"state of shape {state.shape}", f"{(seen, spec.state_size)}", "check the domain's keys")
    if actions.shape != (steps, spec.action_size):
        _refuse(trajectory, f"actions of shape {actions.shape}", f"{(steps, spec.action_size)}", "check the expert")
    _check_images(trajectory, spec, seen)
    _check_values(trajectory, spec, state, actions)
    told = trajectory.task, int(trajectory.seed), bool(trajectory.success)
    # An importer's images are read no sooner than they are asked for here.
    return Episode(*told, state, actions, tuple(images), lambda camera: np.asarray(images[camera]))


def _check_images(trajectory: Trajectory, spec: DomainSpec, rows: int) -> None:
    images, cameras = trajectory.observation.images, {key.name: key.shape for key in spec.image_keys}
    if images.keys() != cameras.keys():
        found, wanted = (", ".join(names) or "none" for names in (images, cameras))
        _refuse(trajectory, f"images of the cameras {found}", wanted, "check the domain's cameras")
    for name, shape in cameras.items():
        expected, given = ((rows, *shape), np.dtype(np.uint8)), (images[name].shape, images[name].dtype)
        if given != expected:
            _refuse(trajectory, f"images {given} of {name!r}", f"{expected}", "check the domain's cameras")


def _check_values(trajectory: Trajectory, spec: DomainSpec, state: np.ndarray, actions: np.ndarray) -> None:
    for key in spec.state_keys:
        steps = np.flatnonzero(~np.isfinite(state[:, spec.columns([key.name])]).all(axis=1))
        if len(steps):
            found = f"a value that is not finite in {key.name!r}, step {steps[0]}"
            _refuse(trajectory, found, "finite values", "leave it out")
    steps = np.flatnonzero(~(np.abs(actions) <= 1).all(axis=1))
    if len(steps):
        found = f"actions {actions[steps[0]].tolist()} in step {steps[0]}"
        _refuse(trajectory, found, "finite values in [-1, 1]", "clip or scale what the expert gives")


def _refuse(trajectory: Trajectory, found: str, expected: str, remedy: str) -> NoReturn:
    raise TrajectoryFileError(
        f"demonstration of task {trajectory.task!r} in domain {trajectory.domain!r}, seed {trajectory.seed}: "
        f"found {found}; expected {expected}: {remedy}"
    )
