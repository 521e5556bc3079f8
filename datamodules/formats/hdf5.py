"""Arrays of other projects' HDF5 files, looked at before they are read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from datamodules.formats.source import refuse_source
from datamodules.store.guard import UNSUSPICIOUS_BYTES, open_guarded, readable

NUMBERS = "fiub"


@contextmanager
def foreign_file(path: Path) -> Iterator[h5py.File]:
    """Open another project's file; whatever HDF5 raises on it meanwhile becomes a :class:`TrajectoryFileError`."""
    with open_guarded(path, foreign=True) as file, readable(path):
        yield file


def find_array(group: h5py.Group, name: str, path: Path) -> h5py.Dataset:
    """Look up an array below a group; a :class:`TrajectoryFileError` says if there is none that can be read safely."""
    array = group.get(name)
    at = f"{group.name.rstrip('/')}/{name}"
    if not isinstance(array, h5py.Dataset):
        refuse_source(path, f"no array {at}", "all arrays of the format")
    # A growing array may have blocks larger than itself, and HDF5 unpacks whole blocks.
    block = math.prod(array.chunks or (1,)) * array.dtype.itemsize
    if block > UNSUSPICIOUS_BYTES:
        refuse_source(path, f"{at} in blocks of {block / 2**20:.0f} MiB", f"at most {UNSUSPICIOUS_BYTES / 2**20:.0f}")
    return array


def find_numbers(group: h5py.Group, name: str, path: Path, shape: tuple[int | None, ...]) -> np.ndarray:
    """Read an array of numbers ``(N, …)``; a :class:`TrajectoryFileError` says if its shape is not the expected one."""
    array = find_array(group, name, path)
    fits = len(array.shape) == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in NUMBERS:
        expected = f"({', '.join('any' if n is None else str(n) for n in shape)}), numbers"
        refuse_source(path, f"{array.name} of shape {array.shape}, type {array.dtype}", expected)
    values: np.ndarray = array[()]
    return values


def texts(array: h5py.Dataset) -> np.ndarray:
    """Texts ``(N,)`` of an array of strings of either kind."""
    return np.array([_text(value) for value in np.atleast_1d(array[()])], dtype=object)


def text_attribute(item: h5py.Group, name: str) -> str | None:
    """Text of an attribute; None if there is none or it is no text."""
    value = item.attrs.get(name)
    return _text(value) if isinstance(value, str | bytes) else None


def integer_attribute(item: h5py.Group, name: str) -> int | None:
    """Whole number of an attribute; None if there is none or it is no such number."""
    value = item.attrs.get(name)
    return int(value) if np.ndim(value) == 0 and np.asarray(value).dtype.kind in "iu" else None


def number_attributes(item: h5py.Group, name: str, size: int) -> tuple[float, ...] | None:
    """Numbers ``(size,)`` of an attribute; None if there is none of this size."""
    value = np.asarray(item.attrs.get(name, ()))
    fits = value.shape == (size,) and value.dtype.kind in "fi" and np.isfinite(value).all()
    return tuple(map(float, value)) if fits else None


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
