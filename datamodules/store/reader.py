"""Reading trajectory files: whole domains in a few contiguous reads, or one demonstration at a time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import h5py
import numpy as np

from datamodules.errors import TrajectoryFileError, UserError
from datamodules.store import schema
from datamodules.store.guard import open_guarded, readable
from datamodules.types import DomainSpec, Observation, Trajectory

FAR_APART = 8  # Times as many rows as are asked for that one read may span


Chosen: TypeAlias = "Sequence[int] | np.ndarray | None"
"""Numbers ``(E,)`` of episodes in any order; None for all."""


class EpisodeTable(NamedTuple):
    """The episodes of one domain, in the order of the file."""

    offset: np.ndarray
    """``(E + 1,)`` int64: steps ``offset[e]`` to ``offset[e + 1]`` of the domain's arrays are episode e."""
    task: np.ndarray  # ``(E,)`` task names
    seed: np.ndarray  # ``(E,)`` int64
    success: np.ndarray  # ``(E,)`` bool
    last: np.ndarray
    """``(E,)`` int64: row of the domain's observations that holds what was seen after the last action; -1 if nobody
    knows, as in all episodes of files of format 1.0."""


class DomainArrays(NamedTuple):
    """Chosen episodes of one domain, laid end to end: N steps of E episodes, then the L last observations known."""

    state: np.ndarray  # ``(N + L, O)`` float32: the domain's state keys, concatenated in the order of its spec
    images: Mapping[str, np.ndarray]
    """By camera ``(N + L, H, W, C)`` uint8; empty in a domain without one, or if images were not asked for."""
    actions: np.ndarray  # ``(N, A)`` float32 in [-1, 1]
    offset: np.ndarray  # ``(E + 1,)`` int64: where each episode begins, and N
    task: np.ndarray  # ``(E,)`` task names
    last: np.ndarray
    """``(E,)`` int64: row of state and images that holds an episode's last observation; -1 if nobody knows."""


class TrajectoryFile:
    """A finished trajectory file, open for reading.

    The object may be pickled and used in other processes, forked or not: each opens the file for itself
    when it first reads. Use :meth:`open`, and the object as a context manager.

    Raises:
        UserError: If a method is asked for a domain, an episode or a camera that the file lacks.
        TrajectoryFileError: If the file turns out to be damaged.
    """

    def __init__(self, path: Path, file: h5py.File, header: schema.Header) -> None:
        self.path, self.hashes = path, schema.read_hashes(file)
        self.tasks, self.domains = header.tasks, header.domains
        self.provenance, self.version = header.provenance, header.version
        self._file: h5py.File | None = file
        self._owner = os.getpid()
        self._tables: dict[str, EpisodeTable] = {}

    @classmethod
    def open(cls, path: Path | str) -> TrajectoryFile:
        """Open a file after checking that it is harmless, complete and of this format.

        The values of the arrays are not checked: see :func:`verify_hashes`.

        Raises:
            TrajectoryFileError: If it is missing, damaged, hostile, unfinished or of another format or version.
        """
        path = Path(path).absolute()
        file = open_guarded(path, schema.most_objects)
        try:
            with readable(path):
                return cls(path, file, schema.read_header(file, path))
        except BaseException:
            file.close()
            raise

    def __enter__(self) -> TrajectoryFile:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_file": None}

    def close(self) -> None:
        """Close the file; reading again opens it again."""
        if self._file is not None:
            self._file.close()
        self._file = None

    def spec(self, domain: str) -> DomainSpec:
        """Look up the spec of a domain; a :class:`UserError` names those that the file has."""
        specs = {spec.name: spec for spec in self.domains}
        if domain not in specs:
            raise UserError(f"{self.path}: no domain {domain!r}; it has: {', '.join(specs)}")
        return specs[domain]

    def counts(self) -> dict[str, dict[str, int]]:
        """Number of episodes by domain and task, with zeros."""
        tables = {spec.name: self.episodes(spec.name).task for spec in self.domains}
        return {name: {task: int((table == task).sum()) for task in self.tasks} for name, table in tables.items()}

    def episodes(self, domain: str) -> EpisodeTable:
        """Episode table of a domain, each column ``(E,)`` but the offsets ``(E + 1,)``; read once."""
        if domain not in self._tables:
            group, columns = f"/domains/{self.spec(domain).name}/episodes", schema.episode_columns(self.version)
            offset, task, *others = (self._array(f"{group}/{name}")[()] for name in columns)
            unknown = () if "last" in columns else (np.full(len(task), -1),)
            self._tables[domain] = EpisodeTable(offset, np.array(self.tasks, np.str_)[task], *others, *unknown)
        return self._tables[domain]

    def read(self, domain: str, episodes: Chosen = None, images: bool = True) -> DomainArrays:
        """Read episodes of a domain into memory, N steps and L last observations.

        Args:
            domain: Name of the domain.
            episodes: Numbers ``(E,)`` of episodes in any order; None for all.
            images: Whether to read images ``(N + L, H, W, C)``, if the domain has cameras.
        """
        spec, table = self.spec(domain), self.episodes(domain)
        chosen, rows = self._chosen(domain, episodes), self.rows(domain, episodes)
        offset = np.concatenate([[0], np.cumsum(np.diff(table.offset)[chosen])]).astype(np.int64)
        known = table.last[chosen] >= 0
        last = np.where(known, offset[-1] + np.cumsum(known) - 1, -1)
        seen = {key.name: self.images(domain, episodes, key.name) for key in spec.image_keys if images}
        actions = self._gather(f"/domains/{domain}/actions", rows[: offset[-1]])
        return DomainArrays(self._state(spec, rows), seen, actions, offset, table.task[chosen], last)

    def rows(self, domain: str, episodes: Chosen = None) -> np.ndarray:
        """Rows ``(N + L,)`` int64 of episodes in the domain's arrays: all their steps, then their last observations."""
        offset, chosen = self.episodes(domain).offset, self._chosen(domain, episodes)
        lengths = np.diff(offset)[chosen]
        starts = offset[chosen] - np.cumsum(lengths) + lengths
        last = self.episodes(domain).last[chosen]
        return np.concatenate([np.repeat(starts, lengths) + np.arange(lengths.sum()), last[last >= 0]])

    def images(self, domain: str, episodes: Chosen = None, camera: str | None = None) -> np.ndarray:
        """Images of episodes ``(N + L, H, W, C)`` uint8, end to end, then those seen last, as far as known.

        They are of one camera, which needs no name where a domain has no other.
        """
        return self._stream(self._camera(domain, camera), self.rows(domain, episodes))

    def image_range(self, domain: str, start: int, stop: int, camera: str | None = None) -> np.ndarray:
        """Images of the rows ``start`` to ``stop`` (or the end) of a domain's observations, ``(n, H, W, C)`` uint8."""
        place = self._camera(domain, camera)
        return self._stream(place, np.arange(start, min(stop, len(self._array(place)))))

    def image_block(self, domain: str, camera: str | None = None) -> int:
        """Images that are compressed together, and so cost no more to read than one of them."""
        chunks = self._array(self._camera(domain, camera)).chunks
        return 1 if chunks is None else int(chunks[0])

    def image_shape(self, domain: str, camera: str | None = None) -> tuple[int, ...]:
        """Shape ``(M, H, W, C)`` of all images of a camera."""
        return tuple(self._array(self._camera(domain, camera)).shape)

    def image_hash(self, domain: str, camera: str | None = None) -> str | None:
        """SHA-256 that the writer has stored of all images of a camera, ``(M, H, W, C)``, as schema.digest takes it."""
        return self.hashes.get(self._camera(domain, camera))

    def trajectory(self, domain: str, episode: int) -> Trajectory:
        """Read one demonstration: states ``(T + 1, O)``, actions ``(T, A)``."""
        table, arrays = self.episodes(domain), self.read(domain, [episode])
        told = int(table.seed[episode]), bool(table.success[episode])
        observation = Observation(arrays.state, arrays.images)
        return Trajectory(domain, str(table.task[episode]), observation, arrays.actions, *told)

    def damaged(self) -> list[str]:
        """Paths of the arrays whose values differ from what the writer stored; reads the whole file."""
        paths = [place for spec in self.domains for place in schema.array_paths(spec, self.version)]
        return [place for place in paths if self.hashes.get(place) != self._stored_digest(place)]

    def _state(self, spec: DomainSpec, rows: np.ndarray) -> np.ndarray:
        columns = [self._gather(f"/domains/{spec.name}/obs/{key.name}", rows) for key in spec.state_keys]
        if len(columns) == 1:
            return columns[0]
        return np.concatenate([np.empty((len(rows), 0), np.float32), *columns], axis=1)

    def _camera(self, domain: str, camera: str | None) -> str:
        cameras = [key.name for key in self.spec(domain).image_keys]
        if not cameras:
            raise UserError(f"{self.path}: domain {domain!r} has no camera; ask for its state alone")
        if camera not in cameras and (camera is not None or len(cameras) > 1):
            asked = "no camera was named" if camera is None else f"no camera {camera!r}"
            raise UserError(f"{self.path}: {asked} of domain {domain!r}; it has: {', '.join(cameras)}")
        return f"/domains/{domain}/obs/{camera or cameras[0]}"

    def _stored_digest(self, place: str) -> str:
        try:
            with readable(self.path):
                return schema.stored_digest(self._array(place))
        except TrajectoryFileError:
            return "unreadable"

    def _chosen(self, domain: str, episodes: Chosen) -> np.ndarray:
        count = len(self.episodes(domain).task)
        chosen = np.arange(count) if episodes is None else np.asarray(episodes, np.int64)
        if ((chosen < 0) | (chosen >= count)).any():
            raise UserError(f"{self.path}: domain {domain!r} has episodes 0 to {count - 1}; asked for {chosen.max()}")
        return chosen

    def _array(self, place: str) -> h5py.Dataset:
        if self._file is None or self._owner != os.getpid():
            # A handle that came through a fork must not be used: https://github.com/pytorch/pytorch/issues/11929
            file = open_guarded(self.path, schema.most_objects)
            if schema.read_hashes(file) != self.hashes:
                raise TrajectoryFileError(f"{self.path}: the file was replaced while in use; start again")
            self._file, self._owner = file, os.getpid()
        return self._file[place]

    def _gather(self, place: str, rows: np.ndarray) -> np.ndarray:
        """One read that spans all rows, then a gather: fastest for vectors, unless the rows are far apart."""
        if not len(rows) or np.ptp(rows) >= FAR_APART * len(rows):
            return self._stream(place, rows)
        with readable(self.path):
            array = self._array(place)
            span: np.ndarray = array[rows.min() : rows.max() + 1]
            return span if (np.diff(rows) == 1).all() else span[rows - rows.min()]

    def _stream(self, place: str, rows: np.ndarray) -> np.ndarray:
        """One read for each run of neighbouring rows: nothing that is not asked for is decompressed or held."""
        with readable(self.path):
            array = self._array(place)
            out = np.empty((len(rows), *array.shape[1:]), array.dtype)
            breaks = np.flatnonzero(np.diff(rows) != 1) + 1
            for start, stop in zip([0, *breaks], [*breaks, len(rows)], strict=True):
                if start < stop:
                    array.read_direct(out, np.s_[rows[start] : rows[stop - 1] + 1], np.s_[start:stop])
            return out


def stored_count(path: Path, domain: str, task: str) -> int:
    """Number of demonstrations of a task in a domain that the file at ``path`` holds, if there is one."""
    if not path.exists():
        return 0
    with TrajectoryFile.open(path) as file:
        return file.counts().get(domain, {}).get(task, 0)


def verify_hashes(path: Path | str) -> None:
    """Read the whole trajectory file and compare every array with its hash.

    Raises:
        TrajectoryFileError: If the file cannot be opened or a value in it has changed since it was written.
    """
    with TrajectoryFile.open(path) as file:
        damaged = file.damaged()
    if damaged:
        found = f"values of {damaged[0]} that do not match their hash ({len(damaged)} arrays in all)"
        raise TrajectoryFileError(f"{path}: found {found}; expected what the writer stored: copy or collect it again")
