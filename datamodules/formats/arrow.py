"""Episodes of Minari's Arrow layout: a folder an episode with one Arrow or Parquet file and its metadata."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.formats.frames import Frames, decode
from datamodules.formats.metadata import inside, read_object
from datamodules.formats.parquet import arrow_errors, extra, parquet_file, to_numpy
from datamodules.formats.source import Values, refuse_source
from datamodules.formats.spaces import Leaf

METADATA = "metadata.json"


class ArrowEpisodes:
    """Episodes in ``<data>/<number>/part-0.arrow`` or ``.parquet``; actions and rewards are padded by a last row.

    Args:
        data: Folder of the dataset's metadata.
        layout: ``arrow`` or ``parquet``.
    """

    def __init__(self, data: Path, layout: str) -> None:
        self.data, self.layout = data, layout
        self.numbers = sorted(int(path.name) for path in data.iterdir() if path.name.isdecimal() and path.is_dir())
        self.files = [self.place(number) for number in self.numbers]
        self._table = lru_cache(maxsize=1)(self._read)

    def place(self, number: int) -> Path:
        """File of an episode."""
        return inside(self.data, f"{number}/part-0.{self.layout}")

    def options(self, number: int) -> dict[str, Any]:
        """Seed and options of an episode."""
        found = read_object(inside(self.data, f"{number}/{METADATA}"))
        options = found.get("options")
        return {"seed": found.get("seed"), "options": options if isinstance(options, dict) else {}}

    def infos(self) -> list[str]:
        """Names of the infos."""
        table = self._table(self.numbers[0])
        if "infos" not in table.schema.names:
            return []
        infos = table.column("infos").type
        return [infos.field(i).name for i in range(infos.num_fields)]

    def numbers_of(self, number: int, name: str) -> np.ndarray:
        """Values ``(T, n)`` of a column."""
        return to_numpy(self._column(number, name), self._told(number, name))[:-1]

    def values(self, number: int, leaf: Leaf) -> Values:
        """Observations ``(T + 1, …)`` of a leaf."""
        place = self._told(number, leaf.name)
        if leaf.image:
            rows = len(self._column(number, "observations"))
            return Frames((rows, *leaf.shape), partial(self._images, number, leaf, place), place)
        values = to_numpy(self._part(number, leaf), place)
        return values.reshape(len(values), *leaf.shape) if values.size == len(values) * _size(leaf) else values

    def info(self, number: int, name: str) -> np.ndarray:
        """Values ``(T + 1, …)`` of an info."""
        with arrow_errors(self.place(number)):
            return to_numpy(self._column(number, "infos").field(name), self._told(number, name))

    def _images(self, number: int, leaf: Leaf, place: str) -> Iterator[np.ndarray]:
        part = self._part(number, leaf)
        for step in range(len(part)):
            if leaf.jpeg:
                yield decode(part[step].as_py() or b"", leaf.shape, f"{place}, step {step}")
            else:
                yield to_numpy(part[step : step + 1], place).astype(np.uint8).reshape(leaf.shape)

    def _part(self, number: int, leaf: Leaf) -> Any:
        part = self._column(number, "observations")
        with arrow_errors(self.place(number)):
            for name in leaf.path:
                part = part.field(name)
        return part

    def _column(self, number: int, name: str) -> Any:
        table = self._table(number)
        if name not in table.schema.names:
            refuse_source(self.place(number), f"no column {name!r}", f"one of: {', '.join(table.schema.names)}"[:500])
        return table.column(name)

    def _read(self, number: int) -> Any:
        """The whole episode as one record batch; Minari gives each a file of its own."""
        path, arrow = self.place(number), extra("pyarrow")
        if not path.is_file():
            refuse_source(path, "no such file", f"the file of episode {number}")
        if self.layout == "parquet":
            with parquet_file(path, []) as file:
                table = file.read(use_threads=False)
        else:
            with arrow_errors(path), arrow.OSFile(str(path)) as opened:
                table = arrow.ipc.open_file(opened).read_all()
        with arrow_errors(path):
            table.validate(full=True)  # or offsets in a hostile file would lead out of memory
            found = table.combine_chunks().to_batches()
        if len(found) != 1:
            refuse_source(path, f"{len(found)} pieces", "the rows of one episode")
        return found[0]

    def _told(self, number: int, name: str) -> str:
        return f"{self.place(number)}: episode_{number}, {name}"


def write_episode(
    data: Path,
    number: int,
    observations: Mapping[str, np.ndarray],
    arrays: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
) -> None:
    """Write one episode: observations ``(T + 1, …)``, other arrays ``(T, …)``, which get a last row of zeros."""
    arrow, folder = extra("pyarrow"), data / str(number)
    folder.mkdir()
    padded = {name: np.concatenate([array, np.zeros_like(array[:1])]) for name, array in arrays.items()}
    seen = arrow.StructArray.from_arrays([_listed(values) for values in observations.values()], [*observations])
    columns = {"observations": seen, **{name: _listed(array) for name, array in padded.items()}}
    batch = arrow.RecordBatch.from_pydict(columns)
    with arrow.OSFile(str(folder / "part-0.arrow"), "wb") as file, arrow.ipc.new_file(file, batch.schema) as writer:
        writer.write_batch(batch)
    (folder / METADATA).write_text(json.dumps(metadata))


def _listed(values: np.ndarray) -> Any:
    arrow = extra("pyarrow")
    if values.ndim == 1:
        return arrow.array(values)
    flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
    return arrow.FixedSizeListArray.from_arrays(flat, values[0].size)


def _size(leaf: Leaf) -> int:
    return int(np.prod(leaf.shape, dtype=np.int64))
