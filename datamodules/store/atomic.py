"""Files that are complete or absent: written beside their place, checked, then moved in one step."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from datamodules.errors import UserError


def final_path(path: Path | str) -> Path:
    """Absolute path of the file that a path leads to, through links, whether it is there yet or not.

    Raises:
        UserError: If the path is a folder, or a link that leads back to itself.
    """
    path = Path(path)
    try:
        os.stat(path)
    except OSError as error:
        if error.errno == errno.ELOOP:
            found = f"{path}: is a link that leads back to itself"
            raise UserError(f"{found}; expected a file or a free name: remove the link or name another") from error
    if path.is_dir():
        raise UserError(f"{path}: is a folder; expected a file or a free name: name a file in it")
    return path.resolve()


@contextmanager
def locked_folder(folder: Path) -> Iterator[int]:
    """Let one writer at a time, of any process, work in an existing folder; killed writers let go.

    Where the file system has no such locks the block runs unlocked, as two writers at once are rare.
    """
    with _opened(folder) as descriptor:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the same folder that takes the place of ``path`` if the block succeeds.

    Call it inside :func:`locked_folder`: leftovers of writers that were killed are swept first. If the block raises,
    the temporary file is removed and ``path`` stays as it was.

    Raises:
        OSError: If the file cannot be written, which names ``path``.
    """
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        leftover.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        yield temporary
        with _opened(temporary) as written:
            os.fsync(written)
        os.replace(temporary, path)
        with _opened(path.parent) as folder:
            os.fsync(folder)
    except OSError as error:
        if error.filename in (None, str(temporary)):  # a full disk names no file
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, text: str) -> None:
    """Write a text file in one visible step; its folder has to exist."""
    path = final_path(path)
    with locked_folder(path.parent), replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
