"""Content that takes long to make and is the same for each run of a user: made once, then read from a cache folder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from datamodules.store.atomic import locked_folder, replacing

DIGEST = 32  # bytes of SHA-256, ahead of the content


def cache_folder() -> Path:
    """Folder in which content is kept: ``PLP_CACHE``, or ``plp`` in the user's own folder for such files."""
    own = os.environ.get("PLP_CACHE") or os.path.join(os.environ.get("XDG_CACHE_HOME") or "~/.cache", "plp")
    try:
        return Path(own).expanduser().absolute()
    except RuntimeError:  # a user without a home keeps nothing
        return Path(os.devnull)


def kept(name: str, make: Callable[[], bytes]) -> bytes:
    """Content of that name, read from the cache folder, or else made and kept there.

    Of several processes that lack it one makes it. What is damaged is made anew; if nothing can be kept, it is made
    in every process. Whoever changes what ``make`` gives changes the name, too.
    """
    path = cache_folder() / name
    content = _read(path)
    if content is None:
        with _alone(path.parent):
            content = _read(path)
            if content is None:
                content = make()
                _write(path, content)
    return content


def origin(package: str, code: Path) -> str:
    """Hash of a folder's code, MuJoCo's version, and names, sizes and times of a package's files."""
    digest = hashlib.sha256(version("mujoco").encode())
    for path in sorted(code.glob("*.py")):
        digest.update(path.read_bytes())
    found = find_spec(package)
    folders = found.submodule_search_locations if found else None
    for path in sorted(path for folder in folders or () for path in Path(folder).rglob("*.*")):
        if path.suffix != ".pyc":
            told = path.stat()
            digest.update(f"{path} {told.st_size} {told.st_mtime_ns}".encode())
    return digest.hexdigest()[:16]


def _read(path: Path) -> bytes | None:
    try:
        found = path.read_bytes()
    except OSError:
        return None
    content = found[DIGEST:]
    return content if found[:DIGEST] == hashlib.sha256(content).digest() else None


def _write(path: Path, content: bytes) -> None:
    with suppress(OSError), replacing(path) as temporary:
        temporary.write_bytes(hashlib.sha256(content).digest() + content)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    with ExitStack() as stack:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked_folder(folder))
        yield
