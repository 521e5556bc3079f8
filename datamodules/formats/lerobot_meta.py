"""Metadata of LeRobot's datasets: which episode is in which rows of which files."""

from __future__ import annotations

import string
from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from datamodules.formats.metadata import entry, inside, read_objects
from datamodules.formats.parquet import parquet_file, read_columns
from datamodules.formats.source import refuse_source

FIELDS = ("episode_chunk", "chunk_index", "file_index", "episode_index", "video_key")
MAX_DIGITS = 9


class Episode(NamedTuple):
    """An episode of a dataset."""

    number: int  # Its ``episode_index``
    length: int
    path: Path  # Its table
    videos: dict[str, tuple[Path, float]]  # By camera: file, and the time at which the episode begins there
    seed: int | None

    @property
    def files(self) -> list[Path]:
        """All files that it is in."""
        return [self.path, *(path for path, _ in self.videos.values())]


def fill_template(template: str, values: dict[str, int | str]) -> str:
    """Fill known fields such as ``{episode_index:06d}`` into a path of metadata, which may be hostile.

    Raises:
        ValueError: If it has other fields than the known ones, or asks for anything but digits.
    """
    filled = []
    for text, field, form, conversion in string.Formatter().parse(template):
        filled.append(text)
        if field is None:
            continue
        digits = (form or "").removesuffix("d")
        if field not in FIELDS or field not in values or conversion or (digits and not digits.isdecimal()):
            raise ValueError(f"the field {{{field}}}")
        if len(digits) > 2 or int(digits or 0) > MAX_DIGITS:
            raise ValueError(f"{digits} digits")
        filled.append(str(values[field]).zfill(int(digits or 0)))
    return "".join(filled)


def find_tasks(root: Path, version: str) -> dict[int, str]:
    """Sentences by task index."""
    if version != "v3.0":
        place = root / "meta/tasks.jsonl"
        return {entry(r, "task_index", int, place): entry(r, "task", str, place) for r in read_objects(place)}
    path = root / "meta/tasks.parquet"
    with parquet_file(path, ["task_index"]) as file:
        names = [name for name in file.schema_arrow.names if name != "task_index"]
    named = next((name for name in ("task", "__index_level_0__") if name in names), None)
    if named is None:
        refuse_source(path, f"the columns {', '.join(names)}"[:300], "task and task_index")
    found = read_columns(path, ["task_index", named])
    return {int(i): str(text) for i, text in zip(found["task_index"], found[named], strict=True)}


def find_episodes(root: Path, info: dict[str, Any], version: str, videos: Sequence[str]) -> Iterator[Episode]:
    """Episodes in the order of their tables."""
    table = _Paths(root, info, bool(videos))
    yield from (_episodes_v3 if version == "v3.0" else _episodes_v2)(root, info, table, videos)


class _Paths:
    """Paths of tables and videos by the templates of the metadata."""

    def __init__(self, root: Path, info: dict[str, Any], videos: bool) -> None:
        self.root, self.place = root, root / "meta/info.json"
        self._inside = cache(partial(inside, root))  # many episodes are in one file
        self.data = entry(info, "data_path", str, self.place)
        self.video = entry(info, "video_path", str, self.place) if videos else ""

    def of(self, template: str, **values: int | str) -> Path:
        try:
            return self._inside(fill_template(template, dict(values)))
        except ValueError as error:
            refuse_source(self.place, f"{error} in the path {template[:100]!r}", f"fields {', '.join(FIELDS)}")


def _episodes_v2(root: Path, info: dict[str, Any], paths: _Paths, videos: Sequence[str]) -> Iterator[Episode]:
    size = entry(info, "chunks_size", int, paths.place)
    if size < 1:
        refuse_source(paths.place, f"chunks_size {size}", "at least 1")
    place = root / "meta/episodes.jsonl"
    for record in read_objects(place):
        index, length = entry(record, "episode_index", int, place), entry(record, "length", int, place)
        chunk, seed = index // size, record.get("seed")
        fields = {"episode_chunk": chunk, "episode_index": index}
        films = {key: (paths.of(paths.video, video_key=key, **fields), 0.0) for key in videos}
        told = seed if type(seed) is int else None
        yield Episode(index, length, paths.of(paths.data, **fields), films, told)


def _episodes_v3(root: Path, info: dict[str, Any], paths: _Paths, videos: Sequence[str]) -> Iterator[Episode]:
    columns = ["episode_index", "length", "data/chunk_index", "data/file_index"]
    columns += [f"videos/{key}/{name}" for key in videos for name in ("chunk_index", "file_index", "from_timestamp")]
    files = sorted(root.glob("meta/episodes/*/*.parquet"))
    if not files:
        refuse_source(root / "meta/episodes", "no table", "chunk-000/file-000.parquet and so on")
    for path in files:
        with parquet_file(path, columns) as file:
            seeded = ["seed"] if "seed" in file.schema_arrow.names else []
        found = read_columns(path, [*columns, *seeded])
        for row in range(len(found["length"])):
            yield _episode_v3({name: values[row] for name, values in found.items()}, paths, videos)


def _episode_v3(row: dict[str, Any], paths: _Paths, videos: Sequence[str]) -> Episode:
    def of(template: str, prefix: str, **more: str) -> Path:
        places = {name: int(row[f"{prefix}/{name}"]) for name in ("chunk_index", "file_index")}
        return paths.of(template, **places, **more)

    films = {
        key: (of(paths.video, f"videos/{key}", video_key=key), float(row[f"videos/{key}/from_timestamp"]))
        for key in videos
    }
    seed = int(row["seed"]) if "seed" in row else None
    return Episode(int(row["episode_index"]), int(row["length"]), of(paths.data, "data"), films, seed)
