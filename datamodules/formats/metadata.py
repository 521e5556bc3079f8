"""Metadata of other projects: JSON that may be hostile, and paths that may lead astray."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from datamodules.errors import TrajectoryFileError
from datamodules.formats.source import refuse_source

MAX_JSON_BYTES = 16 * 2**20
T = TypeVar("T")


def parse_object(text: str | bytes, place: Path | str) -> dict[str, Any]:
    """Read a JSON object; a :class:`TrajectoryFileError` says if it is none, is too long or too deep."""
    _check_size(len(text), place)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        refuse_source(place, f"text that is no JSON ({str(error)[:200]})", "a JSON object")
    if not isinstance(value, dict):
        refuse_source(place, f"a JSON {type(value).__name__}", "a JSON object")
    return value


def read_object(path: Path) -> dict[str, Any]:
    """Read a file that holds one JSON object; a :class:`TrajectoryFileError` says if there is none."""
    if not path.is_file():
        refuse_source(path, "no such file", "a folder with all its metadata")
    _check_size(path.stat().st_size, path)
    return parse_object(path.read_bytes(), path)


def read_objects(path: Path) -> Iterator[dict[str, Any]]:
    """Read a file that holds a JSON object a line; a :class:`TrajectoryFileError` says if a line is none."""
    if not path.is_file():
        refuse_source(path, "no such file", "a folder with all its metadata")
    with path.open("rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(MAX_JSON_BYTES + 1), b""), start=1):
            if line.strip():
                yield parse_object(line, f"{path}: line {number}")


def entry(record: dict[str, Any], name: str, kind: type[T], place: Path | str) -> T:
    """Look up an entry of metadata; a :class:`TrajectoryFileError` says if it is missing or of another type."""
    value = record.get(name)
    if kind is float and type(value) is int and abs(value) < 2**63:
        value = float(value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        found = f"no {name!r}" if name not in record else f"{name!r}: {_short(value)}"
        refuse_source(place, found, f"{name!r} of type {kind.__name__}")
    return value


def inside(root: Path, relative: str) -> Path:
    """Join a path of metadata to its folder; a :class:`TrajectoryFileError` says if it leads out of there."""
    path = root / relative
    if "\0" in relative or not path.resolve().is_relative_to(root.resolve()):
        raise TrajectoryFileError(f"{root}: found the path {_short(relative)}; expected one inside of this folder")
    return path


def _check_size(size: int, place: Path | str) -> None:
    if size > MAX_JSON_BYTES:
        refuse_source(place, f"{size / 2**20:.0f} MiB of JSON", f"at most {MAX_JSON_BYTES / 2**20:.0f}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]}…"
