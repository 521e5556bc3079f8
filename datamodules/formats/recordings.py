"""Recordings of Gymnasium environments by :class:`plp_lightning.recording.Recorder`: a folder, a file an episode.

``recording.json`` tells the environment, its control rate and the limits of its actions; ``episode_000000.hdf5`` and
so on hold ``observations/<key>`` of T + 1 rows, ``actions`` of T and the attributes ``task``, ``seed`` and ``success``.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from datamodules.formats.frames import Frames, image_shape
from datamodules.formats.hdf5 import NUMBERS, find_array, find_numbers, foreign_file, integer_attribute, text_attribute
from datamodules.formats.metadata import entry, read_object
from datamodules.formats.source import (
    Format,
    Source,
    SourceDescription,
    SourceEpisode,
    SourceKey,
    Values,
    refuse_source,
)

HEADER = "recording.json"
EPISODE = re.compile(r"episode_\d{6,9}\.hdf5")


class Recordings(Format):
    """Recordings of Gymnasium environments."""

    title = "recordings of a Gymnasium environment"

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        yield _RecordingSource(path)


class _RecordingSource(Source):
    def __init__(self, folder: Path) -> None:
        self.header, self.place = read_object(folder / HEADER), folder / HEADER
        self.paths = sorted(path for path in folder.iterdir() if EPISODE.fullmatch(path.name))
        if not self.paths:
            refuse_source(folder, "no recorded episode", "episode_000000.hdf5 and so on")
        with foreign_file(self.paths[0]) as file:
            keys = [_key(name, find_array(file, f"observations/{name}", self.paths[0])) for name in _names(file)]
            size = find_array(file, "actions", self.paths[0]).shape[-1]
        low, high = (self._limits(name, size) for name in ("action_low", "action_high"))
        self.description = SourceDescription(
            place=folder,
            files=[self.place, *self.paths],
            keys=keys,
            action_size=size,
            episodes=len(self.paths),
            fps=None if self.header.get("fps") is None else entry(self.header, "fps", float, self.place),
            action_low=low if high else None,
            action_high=high if low else None,
            env=entry(self.header, "env", str, self.place),
        )

    def _limits(self, name: str, size: int) -> tuple[float, ...] | None:
        found = entry(self.header, name, list, self.place) if self.header.get(name) is not None else []
        if len(found) not in (0, size) or not all(isinstance(value, int | float) for value in found):
            refuse_source(self.place, f"{name} {found}", f"{size} numbers")
        values = tuple(map(float, found))
        return values if values and np.isfinite(values).all() else None

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        for path in self.paths:
            with foreign_file(path) as file:
                values = {key: _values(file, key, path) for key in keys}
                actions, solved = find_numbers(file, "actions", path, (None, None)), file.attrs.get("success")
                told = text_attribute(file, "task") or None, integer_attribute(file, "seed")
            yield SourceEpisode(path.stem, path, values, actions, *told, None if solved is None else bool(solved))


def _names(file: h5py.File) -> Iterator[str]:
    with contextlib.suppress(KeyError):
        yield from file["observations"]


def _key(name: str, array: h5py.Dataset) -> SourceKey:
    image = array.dtype == np.uint8 and image_shape(array.shape[1:])
    return SourceKey(name, tuple(array.shape[1:]), image, aside=array.dtype.kind not in NUMBERS)


def _values(file: h5py.File, key: str, path: Path) -> Values:
    array = find_array(file, f"observations/{key}", path)
    if _key(key, array).image:
        return Frames(array.shape, partial(_images, path, key), f"{path}: {key}")
    values: np.ndarray = array[()]
    return values


def _images(path: Path, key: str) -> Iterator[np.ndarray]:
    with foreign_file(path) as file:
        yield from find_array(file, f"observations/{key}", path)
