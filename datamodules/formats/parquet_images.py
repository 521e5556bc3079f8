"""Images in a column of a Parquet file: encoded, a row a step."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.formats.frames import decode
from datamodules.formats.parquet import arrow_errors, parquet_file
from datamodules.formats.source import refuse_source


def read_images(
    path: Path, column: str, rows: tuple[int, int], shape: tuple[int, ...], place: str
) -> Iterator[np.ndarray]:
    """Decode the images ``(H, W, C)`` uint8 of the rows from the first of ``rows`` up to the second, one by one."""
    first, stop = rows
    for number, start, length in _groups(path, column):
        if start < stop and first < start + length:
            images = _group(path, column, number)
            for row in range(max(first, start), min(stop, start + length)):
                step = f"{place}, step {row - first}"
                content = images[row - start].as_py()
                if content is None:
                    refuse_source(step, "an image that is not in the table", "PNG or JPEG, in the table itself")
                yield decode(content, shape, step)


@lru_cache(maxsize=64)
def _groups(path: Path, column: str) -> list[tuple[int, int, int]]:
    """Number, first row and length of each row group."""
    with parquet_file(path, [column]) as file:
        lengths = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
    starts = np.cumsum([0, *lengths[:-1]]).tolist()
    return [(i, start, length) for i, (start, length) in enumerate(zip(starts, lengths, strict=True))]


@lru_cache(maxsize=1)
def _group(path: Path, column: str, number: int) -> Any:
    """Encoded images of a row group; episodes that share one are often asked for in turn."""
    with parquet_file(path, [column]) as file:
        table = file.read_row_group(number, columns=[column], use_threads=False)
    with arrow_errors(path):
        found = table.column(column).combine_chunks()
        return found.field("bytes") if found.type.num_fields else found
