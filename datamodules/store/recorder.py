"""Recording piece by piece: each addition is on disk at once, in a part beside the file, and costs the same time."""

from __future__ import annotations

import contextlib
import itertools
import os
import uuid
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from datamodules.errors import TrajectoryFileError
from datamodules.store.atomic import final_path, locked_folder
from datamodules.store.reader import TrajectoryFile, verify_hashes
from datamodules.store.recording import episodes_by_domain, plain_json, stored_episodes, write_file
from datamodules.store.schema import Header
from datamodules.store.writer import Addition, check_growth, extend_file
from datamodules.types import DomainSpec, Trajectory

if TYPE_CHECKING:
    from typing_extensions import Self

OPEN_PARTS = 32  # Parts that are kept open while they are joined
QUICK_BYTES = 32 * 2**20  # What is joined in about a second, even where somebody waits for the process to end


class Recorder:
    """Adds demonstrations to a trajectory file, each on disk when :meth:`add` returns; use it as a context manager.

    What is added becomes a part, a small trajectory file of its own in the folder ``<file>.parts``. The parts are
    joined with the file when the recorder is closed; those of a recorder that was killed by whoever records or
    collects into the file next, or by :func:`join_parts`. The joined file is the one that
    :func:`~datamodules.store.writer.add_trajectories` would have written.

    Args:
        path: The file to grow or to make; missing folders are made.
        domains: Domains of the demonstrations; those that the file knows must be the same as there.
        tasks: Names of all tasks in their canonical order.
        provenance: Command, seeds, versions, expert: anything that JSON can hold.

    Raises:
        TrajectoryFileError: If the file or a part that was left cannot be read, or the file cannot grow so.
    """

    def __init__(
        self, path: Path | str, domains: Sequence[DomainSpec], tasks: Sequence[str], provenance: Mapping[str, Any]
    ) -> None:
        self.path = final_path(path)
        self.header = Header(tuple(tasks), tuple(domains), plain_json(provenance))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        join_parts(self.path)
        if self.path.exists():
            check_growth(self.path, domains)
        self.added = 0  # Demonstrations, up to now
        self._numbers = itertools.count()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            join_parts(self.path)
        elif _total_bytes(self.path) <= QUICK_BYTES:
            with contextlib.suppress(TrajectoryFileError, OSError):  # what went wrong first is told
                join_parts(self.path)

    def add(self, trajectories: Iterable[Trajectory]) -> None:
        """Write demonstrations, states ``(T + 1, O)``, actions ``(T, A)``, to disk, in time that only they decide.

        Raises:
            TrajectoryFileError: If the part cannot be written, or a demonstration does not fit its domain.
        """
        episodes = episodes_by_domain(trajectories, self.header.domains, self.header.tasks)
        folder = parts_folder(self.path)
        # Names in the order of recording, for equal seeds stay as they came; no two recorders share one.
        name = f"{next(self._numbers):08d}-{uuid.uuid4().hex}.hdf5"
        with locked_folder(self.path.parent) as parent:
            folder.mkdir(exist_ok=True)
            os.fsync(parent)
            try:
                write_file(folder / name, self.header, episodes, images="lzf")
            except TrajectoryFileError:
                _remove_empty(folder)
                raise
        self.added += sum(map(len, episodes.values()))


def parts_folder(path: Path) -> Path:
    """Folder of the parts that wait to be joined with the file at ``path``."""
    path = final_path(path)
    return path.with_name(f"{path.name}.parts")


def part_files(path: Path) -> list[Path]:
    """Parts that wait to be joined with the file at ``path``, in the order of their recording."""
    return sorted(parts_folder(path).glob("*.hdf5"))


def join_parts(path: Path | str) -> None:
    """Join a file with the parts that were left beside it, and remove them.

    Raises:
        TrajectoryFileError: If a part is damaged or does not fit the file, which stays as it was.
    """
    path = final_path(path)
    if not part_files(path):
        return
    with locked_folder(path.parent):
        if parts := part_files(path):
            opened = lru_cache(OPEN_PARTS)(TrajectoryFile.open)
            try:
                extend_file(path, [_addition(part, opened) for part in parts])
            finally:
                opened.cache_clear()  # closes them
            _remove(parts)


def _addition(part: Path, opened: Any) -> Addition:
    try:
        verify_hashes(part)
    except TrajectoryFileError as error:
        raise TrajectoryFileError(f"{error}; or remove this part to go on without its demonstrations") from error
    file: TrajectoryFile = opened(part)
    episodes = {spec.name: stored_episodes(file, spec.name, lambda: opened(part)) for spec in file.domains}
    return Header(file.tasks, file.domains, file.provenance), episodes


def _remove(parts: Sequence[Path]) -> None:
    """Remove parts, what killed writers left beside them, and their folder if nothing of others is in it."""
    folder = parts[0].parent
    for file in (*parts, *folder.glob(".*.tmp")):
        file.unlink(missing_ok=True)
    _remove_empty(folder)


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _total_bytes(path: Path) -> int:
    return sum(file.stat().st_size for file in (path, *part_files(path)) if file.exists())
