"""Opening HDF5 files that strangers made: everything is looked at before anything is read.

HDF5 lets a file point at other files, run filter plug-ins, claim terabytes in kilobytes and contain itself.
Every reader of this project opens files through :func:`open_guarded`, which refuses all of that.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

# Read once, when the HDF5 library starts: no file may pull in a compiled filter plug-in.
# https://support.hdfgroup.org/documentation/hdf5/latest/_h5_p_l__u_g.html
os.environ.setdefault("HDF5_PLUGIN_PRELOAD", "::")

import h5py
import numpy as np

from datamodules.errors import TrajectoryFileError

NAME = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9_.-]{1,64}")
MAX_DEPTH = 8
MAX_OBJECTS = 200_000
MAX_ATTRIBUTES = 1000  # Of one object
MAX_ATTRIBUTE_BYTES = 16 * 2**20
UNSUSPICIOUS_BYTES = 256 * 2**20
MAX_EXPANSION = 1000
FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "gzip",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_LZF: "lzf",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}
_LOW_LEVEL = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError)


def is_name(name: str) -> bool:
    """Allow names of 1 to 64 letters, digits, ``_``, ``.`` and ``-`` in files, but not ``.`` and ``..``."""
    return NAME.fullmatch(name) is not None


def as_name(text: str) -> str:
    """Give a text as a name of files and folders: itself if it is one, else its words and digits of its hash."""
    if is_name(text) and text.strip("."):
        return text
    words = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:48]
    return f"{words}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever HDF5 raises on a damaged file into a :class:`TrajectoryFileError` that names the file."""
    try:
        yield
    except (*_LOW_LEVEL, MemoryError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise TrajectoryFileError(
            f"{path}: cannot be read as HDF5 ({reason}); expected an undamaged file: copy or collect it again"
        ) from error


def is_foreign_name(name: str) -> bool:
    """Allow any printable name of up to 255 characters, but not ``.`` and ``..``, in files of other projects."""
    return 0 < len(name) <= 255 and name.isprintable() and "/" not in name and name not in (".", "..")


def open_guarded(path: Path, limit: Callable[[h5py.File, Path], int] | None = None, foreign: bool = False) -> h5py.File:
    """Open a finished HDF5 file read-only after checking every object in it; the caller closes it.

    Args:
        path: The file.
        limit: Reads from the attributes of the file how many objects it may hold, or raises; MAX_OBJECTS if not given.
        foreign: Whether another project made it: names may be any printable text, and it may hold rows of bytes of
            different lengths, such as compressed images.

    Raises:
        TrajectoryFileError: If the file is missing, empty, damaged or uses a feature that can harm its reader.
    """
    kind, remedy = ("HDF5", "the path") if foreign else ("a trajectory file", "the path, collect or import it")
    if path.is_dir():
        raise TrajectoryFileError(f"{path}: is a folder; expected {kind}: name the file in it")
    if not path.is_file():
        raise TrajectoryFileError(f"{path}: no such file; expected {kind}: check {remedy}")
    if path.stat().st_size == 0:
        raise TrajectoryFileError(f"{path}: the file is empty; expected HDF5: copy or collect it again")
    with readable(path):
        # Finished files need no lock, and NFS or Lustre may refuse one: https://github.com/h5py/h5py/issues/1101
        file = h5py.File(path, "r", locking=False)
        try:
            _check_attributes(file, path, "/")
            check_objects(file, path, None if limit is None else limit(file, path), foreign)
        except BaseException:
            file.close()
            raise
    return file


def check_objects(file: h5py.File, path: Path, limit: int | None = None, foreign: bool = False) -> list[str]:
    """Walk all groups and arrays, one name at a time, without reading any array; the first that is not plain raises.

    More than ``limit`` objects are refused; MAX_OBJECTS if not given.

    Returns:
        Paths of all arrays, such as ``/domains/ant/actions``.
    """
    seen, limit = {_address(file)}, MAX_OBJECTS if limit is None else limit
    arrays: list[str] = []
    pending: list[tuple[str, h5py.Group]] = [("", file)]
    while pending:
        place, group = pending.pop()
        _check_attributes(group, path, place or "/")
        for name in group:
            at = f"{place}/{name}"
            child = _member(group, name, path, at, is_foreign_name if foreign else is_name)
            if _address(child) in seen:
                _refuse(path, at, "is reachable by two names", "every object once")
            seen.add(_address(child))
            if len(seen) > limit or at.count("/") > MAX_DEPTH:
                _refuse(path, at, "is one object or level too many", f"{limit} objects, {MAX_DEPTH} levels")
            if isinstance(child, h5py.Group):
                pending.append((at, child))
            else:
                _check_attributes(child, path, at)
                _check_array(child, path, at, foreign)
                arrays.append(at)
    return arrays


def _address(item: h5py.Group | h5py.Dataset) -> int:
    return int(h5py.h5o.get_info(item.id).addr)


def _member(
    group: h5py.Group, name: str, path: Path, at: str, allowed: Callable[[str], bool]
) -> h5py.Group | h5py.Dataset:
    if not allowed(name):
        _refuse(path, ascii(at), "is no allowed name", "1 to 64 letters, digits, '_', '.', '-'")
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        _refuse(path, at, "is a soft or external link", "objects stored in the file itself")
    child = group[name]
    if not isinstance(child, (h5py.Group, h5py.Dataset)):
        _refuse(path, at, "is neither group nor array", "only groups and arrays")
    return child


def _check_attributes(item: h5py.Group | h5py.Dataset, path: Path, at: str) -> None:
    if len(item.attrs) > MAX_ATTRIBUTES:
        _refuse(path, at, f"has {len(item.attrs)} attributes", f"at most {MAX_ATTRIBUTES}")
    for name in item.attrs:
        attribute = h5py.h5a.open(item.id, name.encode())
        if attribute.get_storage_size() > MAX_ATTRIBUTE_BYTES or not _is_plain(attribute.dtype):
            _refuse(path, at, f"has the attribute {name!a} of a strange type or size", "numbers and strings")


def _check_array(array: h5py.Dataset, path: Path, at: str, foreign: bool) -> None:
    if array.external or array.is_virtual:
        _refuse(path, at, "takes its values from other files", "arrays stored in the file itself")
    if not _is_plain(array.dtype) and not (foreign and h5py.check_vlen_dtype(array.dtype) == np.uint8):
        _refuse(path, at, f"has type {array.dtype}", "numbers, booleans or strings")
    plist = array.id.get_create_plist()
    unknown = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())} - FILTERS.keys()
    if unknown:
        _refuse(path, at, f"needs filter {min(unknown)}", f"at most {', '.join(FILTERS.values())}")
    if array.nbytes > max(UNSUSPICIOUS_BYTES, MAX_EXPANSION * array.id.get_storage_size()):
        claim = f"claims {array.nbytes / 2**20:.0f} MiB but stores {array.id.get_storage_size() / 2**20:.3f}"
        _refuse(path, at, claim, f"at most {MAX_EXPANSION} times as much")


def _is_plain(dtype: object) -> bool:
    return h5py.check_string_dtype(dtype) is not None or getattr(dtype, "kind", "?") in "biufS"


def _refuse(path: Path, at: str, found: str, expected: str) -> NoReturn:
    raise TrajectoryFileError(f"{path}: {at} {found}; expected {expected}: get the file from a source you trust")
