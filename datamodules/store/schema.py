"""Format "plp-trajectories" (``docs/format.md``): names of all objects in a file, and whether a file keeps to it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

import h5py
import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.store.guard import MAX_OBJECTS, is_name
from datamodules.types import DomainSpec, ObservationKey

FORMAT = "plp-trajectories"
FORMAT_VERSION = "1.1"  # Of files that are written, unless they hold what only a later one can
SENTENCES_VERSION = "1.2"  # Has limits of actions, and tasks that are sentences
LATEST_VERSION = "1.3"  # Has domains of several cameras, and domains without a state
READABLE = (LATEST_VERSION, SENTENCES_VERSION, FORMAT_VERSION, "1.0")
MAX_TASK_BYTES = 500
HEADER = "header"
EPISODE_COLUMNS: dict[str, type[np.generic]] = {
    "offset": np.int64,
    "task_id": np.int32,
    "seed": np.int64,
    "success": np.bool_,
    "last": np.int64,
}
OBJECTS_OF_A_DOMAIN = 1000  # Keys and what others add; each costs time at every opening
_HASH_BLOCK_BYTES = 16 * 2**20


@dataclass(frozen=True)
class Header:
    """All that a file holds beside arrays."""

    tasks: tuple[str, ...]
    domains: tuple[DomainSpec, ...]
    provenance: dict[str, Any]
    version: str = FORMAT_VERSION

    def digest(self) -> str:
        """Sha256 of the header's JSON."""
        specs = [{**spec.to_dict(), "control_hz": float(spec.control_hz)} for spec in self.domains]
        text = json.dumps([self.tasks, specs, self.provenance], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def version_of(header: Header) -> str:
    """Earliest version of the format that can hold a file, so that it stays readable for as many as can be."""
    if any(len(spec.image_keys) > 1 or not spec.state_keys for spec in header.domains):
        return LATEST_VERSION
    limited = any(spec.action_low is not None for spec in header.domains)
    return SENTENCES_VERSION if limited or not all(map(is_name, header.tasks)) else FORMAT_VERSION


def episode_columns(version: str) -> dict[str, type[np.generic]]:
    """Dtypes of the arrays below ``episodes``; format 1.0 does not know what was seen last."""
    return {name: dtype for name, dtype in EPISODE_COLUMNS.items() if (version, name) != ("1.0", "last")}


def array_paths(spec: DomainSpec, version: str) -> list[str]:
    """Absolute paths of all arrays of a domain."""
    keys, columns = (key.name for key in spec.observation), episode_columns(version)
    below = ["actions", *(f"obs/{name}" for name in keys), *(f"episodes/{name}" for name in columns)]
    return [f"/domains/{spec.name}/{name}" for name in below]


def digest(dtype: np.dtype[Any], shape: Sequence[int], blocks: Iterable[np.ndarray]) -> str:
    """Sha256 of an array: its little-endian type, its shape ``(N, …)`` and its bytes in C order.

    The rows come in blocks ``(n, …)`` of any length.
    """
    sha = hashlib.sha256(f"{dtype.str}{list(shape)}".encode())
    for block in blocks:
        sha.update(np.ascontiguousarray(block).data)
    return sha.hexdigest()


def stored_digest(array: h5py.Dataset) -> str:
    """:func:`digest` of an array ``(N, …)`` in a file, read in pieces."""
    row_bytes = max(1, array.dtype.itemsize * math.prod(array.shape[1:]))
    step = max(8, _HASH_BLOCK_BYTES // row_bytes // 8 * 8)
    return digest(array.dtype, array.shape, (array[i : i + step] for i in range(0, array.shape[0], step)))


def check_spec(spec: DomainSpec, place: str) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, a domain with a name, shape, size or rate that cannot be stored."""
    keys = [key.name for key in spec.observation]
    _check_each([spec.name, *keys], place, "name")
    if len(set(keys)) < len(keys):
        _fail(place, f"observation keys {', '.join(keys)}", "different names")
    ranks = {"state": 1, "image": 3}
    for key in spec.observation:
        if len(key.shape) != ranks.get(key.kind) or min(key.shape) < 1:
            found = f"key {key.name!r} of kind {key.kind!r}, shape {key.shape}"
            _fail(place, found, "(n,) for state, (H, W, C) for image")
    if not "".join([spec.env, *(key.unit for key in spec.observation)]).isprintable():
        _fail(place, "control characters in env or unit", "printable text")
    if spec.action_size < 1 or not 0 < spec.control_hz < math.inf:
        _fail(place, f"{spec.action_size} actions at {spec.control_hz} Hz", "positive, finite numbers")


def check_tasks(tasks: Sequence[str], place: str) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, tasks of which one is no name and no sentence, or stands twice."""
    for task in tasks:
        if not is_task(task):
            _fail(
                place, f"task name {task!r}", f"1 to {MAX_TASK_BYTES} bytes of printable text without blanks around it"
            )
    if len(set(tasks)) < len(tasks):
        _fail(place, f"tasks {', '.join(tasks)}", "every name once")


def is_task(name: str) -> bool:
    """Allow names and sentences: printable text of one line, without blanks around it, but not ``.`` and ``..``."""
    sized = 0 < len(name.encode(errors="replace")) <= MAX_TASK_BYTES
    return sized and name.isprintable() and name == name.strip() and name not in (".", "..")


def _check_each(names: Sequence[str], place: str, kind: str) -> None:
    for name in names:
        if not is_name(name):
            _fail(place, f"{kind} {name!r}", "1 to 64 letters, digits, '_', '.', '-'")


def write_header(file: h5py.File, header: Header) -> None:
    """Write everything but the arrays of the domains, the hashes and ``complete``."""
    file.attrs.update({"format": FORMAT, "format_version": version_of(header)})
    file.attrs["provenance"] = json.dumps(header.provenance, sort_keys=True)
    file.attrs["domains"] = json.dumps([spec.name for spec in header.domains])
    names = [task.encode() for task in header.tasks]
    file["tasks/name"] = np.array(names, f"S{max([64, *map(len, names)])}")
    for spec in header.domains:
        group = file.create_group(f"domains/{spec.name}")
        group.attrs["observation"] = json.dumps([key.name for key in spec.observation])
        group.attrs.update({"action_size": spec.action_size, "control_hz": float(spec.control_hz), "env": spec.env})
        if spec.action_low is not None and spec.action_high is not None:
            group.attrs.update({"action_low": spec.action_low, "action_high": spec.action_high})


def check_identity(file: h5py.File, path: Path) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, a file that is not a finished one of this format and version."""
    found, version, complete = (file.attrs.get(name) for name in ("format", "format_version", "complete"))
    if not isinstance(found, str) or found != FORMAT:
        _fail(
            path,
            f"format {found!r}",
            f"{FORMAT!r}",
            "see 'plp data import --help' for the formats that can be converted",
        )
    if version not in READABLE:
        known = " or ".join(map(repr, READABLE))
        _fail(path, f"format version {version!r}", known, "update plp or convert the file")
    if complete is None or not bool(complete):
        _fail(path, "a file whose writing was never finished", "a complete one")


def most_objects(file: h5py.File, path: Path) -> int:
    """Objects that a finished file of this format may hold, by the number of domains that it announces.

    Raises:
        TrajectoryFileError: If it is none.
    """
    check_identity(file, path)
    announced = str(file.attrs.get("domains")).count(",") + 1
    return min(MAX_OBJECTS, OBJECTS_OF_A_DOMAIN * (announced + 1))


def read_header(file: h5py.File, path: Path) -> Header:
    """Read tasks, domains and provenance, and check that every array has its place, type and shape.

    Raises:
        TrajectoryFileError: Naming the first thing that is not as the format wants it.
    """
    tasks = tuple(name.decode() for name in _array(file, "/tasks/name", path)[()])
    check_tasks(tasks, str(path))
    domains = tuple(_read_spec(file, name, path) for name in json.loads(file.attrs["domains"]))
    header = Header(tasks, domains, dict(json.loads(file.attrs["provenance"])), file.attrs["format_version"])
    if read_hashes(file).get(HEADER) != header.digest():
        _fail(path, "tasks, domains or provenance that do not match their hash", "what the writer stored")
    for spec in domains:
        _check_arrays(file, spec, header.version, path)
    return header


def read_hashes(file: h5py.File) -> dict[str, str]:
    """Sha256 by path of the array, and of the header under ``header``."""
    return cast("dict[str, str]", dict(json.loads(file.attrs["content_sha256"])))


def _read_spec(file: h5py.File, name: str, path: Path) -> DomainSpec:
    place = f"{path}: domain {name!r}"
    if not is_name(name) or f"domains/{name}" not in file:
        _fail(place, "no group of that name", f"/domains/{name}")
    attrs = file[f"domains/{name}"].attrs
    keys = tuple(_read_key(file, f"/domains/{name}/obs", key, path) for key in json.loads(attrs["observation"]))
    if not keys:
        _fail(place, "no observation key", "at least one")
    limits = [tuple(map(float, attrs[limit])) if limit in attrs else None for limit in ("action_low", "action_high")]
    spec = DomainSpec(name, keys, int(attrs["action_size"]), float(attrs["control_hz"]), str(attrs["env"]), *limits)
    check_spec(spec, place)
    return spec


def _read_key(file: h5py.File, place: str, name: str, path: Path) -> ObservationKey:
    attrs = _array(file, f"{place}/{name}", path).attrs
    return ObservationKey(name, tuple(int(n) for n in attrs["shape"]), attrs["kind"], str(attrs["unit"]))


def _array(file: h5py.File, place: str, path: Path) -> h5py.Dataset:
    if not isinstance(file.get(place), h5py.Dataset):
        _fail(path, f"no array {place}", "all arrays of the format")
    return file[place]


def _check_arrays(file: h5py.File, spec: DomainSpec, version: str, path: Path) -> None:
    def check(name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
        array = _array(file, f"{group}/{name}", path)
        if array.shape != shape or array.dtype != dtype:
            found = f"{array.name} of shape {array.shape}, type {array.dtype}"
            _fail(path, found, f"shape {shape}, type {np.dtype(dtype)}")

    group, columns = f"/domains/{spec.name}", episode_columns(version)
    episodes = _array(file, f"{group}/episodes/task_id", path).size
    for name, dtype in columns.items():
        check(f"episodes/{name}", (episodes + (name == "offset"),), dtype)
    _check_table(file, group, path)
    steps = int(file[f"{group}/episodes/offset"][-1])
    rows = steps + (_count_last(file[f"{group}/episodes/last"], steps, path) if "last" in columns else 0)
    check("actions", (steps, spec.action_size), np.float32)
    for key in spec.observation:
        check(f"obs/{key.name}", (rows, *key.shape), np.uint8 if key.kind == "image" else np.float32)


def _count_last(array: h5py.Dataset, steps: int, path: Path) -> int:
    """Number of last observations that a domain knows; they lie behind those of its steps."""
    last: np.ndarray = array[()]
    known = last[last != -1]
    if (known != steps + np.arange(len(known))).any():
        _fail(path, f"{array.name} {known[:4].tolist()}…", f"-1, or {steps} and the rows after it in turn")
    return len(known)


def _check_table(file: h5py.File, group: str, path: Path) -> None:
    offset, task_id = file[f"{group}/episodes/offset"][()], file[f"{group}/episodes/task_id"][()]
    if offset[0] != 0 or (np.diff(offset) <= 0).any():
        _fail(path, f"{group}/episodes/offset {offset[:4].tolist()}…", "0 first, then strictly rising")
    tasks = file["tasks/name"].size
    if ((task_id < 0) | (task_id >= tasks)).any():
        _fail(path, f"a number outside 0…{tasks - 1} in {group}/episodes/task_id", "known tasks")


def _fail(place: Path | str, found: str, expected: str, remedy: str = "collect or copy the file again") -> NoReturn:
    raise TrajectoryFileError(f"{place}: found {found}; expected {expected}: {remedy}")
