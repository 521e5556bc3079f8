"""Columns of Parquet and Arrow files as numpy arrays, with pyarrow, which comes with the extra ``lerobot``."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.errors import ConfigError
from datamodules.formats.source import refuse_source

BATCH_ROWS = 65536
MAX_VALUE_BYTES = 2**31  # Of one column of one row group, unpacked


def extra(module: str) -> Any:
    """Import a module of the extra ``lerobot``; a :class:`ConfigError` says if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        told = f"{module.partition('.')[0]} is not installed; run pip install 'plp-lightning[lerobot]'"
        raise ConfigError(told) from None


@contextmanager
def arrow_errors(path: Path) -> Iterator[None]:
    """Turn what pyarrow raises on a damaged file into a :class:`TrajectoryFileError` that names the file."""
    try:
        yield
    except (extra("pyarrow").ArrowException, OSError, MemoryError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        refuse_source(path, f"what pyarrow cannot read ({reason})", "an undamaged file: copy or record it again")


@contextmanager
def parquet_file(path: Path, columns: Sequence[str]) -> Iterator[Any]:
    """Open a Parquet file that has these columns, none of them suspiciously large."""
    if not path.is_file():
        refuse_source(path, "no such file", "all files that the metadata name")
    with arrow_errors(path), extra("pyarrow.parquet").ParquetFile(path) as file:
        known = file.schema_arrow.names
        for name in columns:
            if name not in known:
                refuse_source(path, f"no column {name!r}", f"one of: {', '.join(known)}"[:500])
        for number in range(file.metadata.num_row_groups):
            group = file.metadata.row_group(number)
            sizes = (group.column(i).total_uncompressed_size for i in range(group.num_columns))
            if max(sizes, default=0) > MAX_VALUE_BYTES:
                refuse_source(path, "a column of more than 2 GiB in one piece", "row groups that fit in memory")
        yield file


def batches(path: Path, columns: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    """Columns ``(n, …)`` of a Parquet file, some thousand rows at a time."""
    with parquet_file(path, columns) as file:
        for batch in file.iter_batches(BATCH_ROWS, columns=[*columns], use_threads=False):
            yield {name: to_numpy(batch.column(name), f"{path}: {name}") for name in columns}


def read_columns(path: Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """Columns ``(N, …)`` of a Parquet file."""
    pieces = [*batches(path, columns)]
    return {name: np.concatenate([piece[name] for piece in pieces]) if pieces else np.empty(0) for name in columns}


def to_numpy(column: Any, place: str) -> np.ndarray:
    """Values of an Arrow array ``(n,)`` of numbers, texts or lists of one length, lists of lists too, ``(n, …)``.

    Raises:
        TrajectoryFileError: If values are missing or lists have different lengths.
    """
    types, shape = extra("pyarrow.types"), [len(column)]
    while types.is_list(column.type) or types.is_large_list(column.type) or types.is_fixed_size_list(column.type):
        _check_full(column, place)
        lengths = np.diff(column.offsets.to_numpy()) if hasattr(column, "offsets") else [column.type.list_size]
        if len(lengths) and np.ptp(lengths):
            step = int(np.flatnonzero(np.asarray(lengths) != lengths[0])[0])
            refuse_source(f"{place}, row {step}", f"{lengths[step]} values", f"{lengths[0]}, as in the row before")
        shape.append(int(lengths[0]) if len(lengths) else 0)
        column = column.flatten()
    _check_full(column, place)
    kind = column.type
    plain = types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
    if not plain and not (types.is_string(kind) or types.is_large_string(kind)):
        refuse_source(place, f"values of type {kind}", "numbers or texts")
    values = column.to_numpy(zero_copy_only=False)
    if len(values) != math.prod(shape):
        refuse_source(place, f"{len(values)} values", f"{math.prod(shape)}")
    return np.asarray(values).reshape(shape)


def _check_full(column: Any, place: str) -> None:
    if column.null_count:
        row = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
        refuse_source(f"{place}, row {row}", "no value", "one in every row")
