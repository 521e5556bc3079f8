"""Files that are complete or absent: written beside their place, checked, then moved in one step."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def locked_folder(folder: Path) -> Iterator[int]:
    """Let one writer at a time, of any process, work in ``folder``; killed writers let go.

    Where the file system has no such locks the block runs unlocked, as two writers at once are rare.

    Args:
        folder: An existing folder.

    Yields:
        A descriptor of the folder.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder that takes the place of ``path`` if the block succeeds.

    Call it inside :func:`locked_folder`: leftovers of writers that were killed are swept first.

    Args:
        path: Where the finished file shall be.

    Yields:
        Where to write it. If the block raises, this file is removed and ``path`` stays as it was.
    """
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        leftover.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
