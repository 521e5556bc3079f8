"""Minari's datasets: a folder with ``metadata.json`` and one HDF5 file, or an Arrow or Parquet file an episode.

See https://minari.farama.org/content/dataset_standards/. Observations have T + 1 rows. Images may be JPEG, with loss.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import h5py
import numpy as np

from datamodules.formats.arrow import ArrowEpisodes, write_episode
from datamodules.formats.exporting import Demonstration, demonstrations, new_folder
from datamodules.formats.frames import Frames, decode
from datamodules.formats.hdf5 import find_array, find_numbers, foreign_file, integer_attribute, text_attribute, texts
from datamodules.formats.metadata import entry, parse_object, read_object
from datamodules.formats.source import (
    NO_SUCCESS,
    Format,
    Source,
    SourceDescription,
    SourceEpisode,
    SourceKey,
    Values,
    refuse_source,
)
from datamodules.formats.spaces import Leaf, box, find_leaves, limits_of
from datamodules.store.guard import as_name
from datamodules.store.reader import TrajectoryFile
from datamodules.types import DomainSpec

METADATA, MAIN = "metadata.json", "main_data.hdf5"
SUCCESS = "success"  # An option of the episode, as the task is


class Minari(Format):
    """Minari's datasets."""

    title = "a Minari dataset"

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        data = path / "data" if (path / "data" / METADATA).is_file() else path
        metadata = read_object(data / METADATA)
        layout = entry(metadata, "data_format", str, data / METADATA) if "data_format" in metadata else "hdf5"
        if layout in ("arrow", "parquet"):
            yield _MinariSource(data, metadata, ArrowEpisodes(data, layout))
        elif layout == "hdf5":
            with foreign_file(data / MAIN) as file:
                yield _MinariSource(data, metadata, _HDF5Episodes(file, data / MAIN))
        else:
            refuse_source(data / METADATA, f"data_format {layout[:50]!r}", "hdf5, arrow or parquet")

    def write(
        self, file: TrajectoryFile, domain: str, out: Path, layout: Literal["hdf5", "arrow"] = "hdf5"
    ) -> Sequence[str]:
        """Write a dataset of T + 1 observations an episode, images without loss.

        Args:
            file: Our file.
            domain: The domain.
            out: Folder of the new dataset.
            layout: One HDF5 file, or a folder an episode with an Arrow file.
        """
        spec, count, steps = file.spec(domain), 0, int(file.episodes(domain).offset[-1])
        unknown = int((file.episodes(domain).last < 0).sum())
        if unknown:
            refuse_source(
                file.path, f"{unknown} demonstrations without a last observation", "T + 1, as Minari has them"
            )
        with new_folder(out) as temporary:
            data = temporary / "data"
            data.mkdir()
            for count, one in enumerate(demonstrations(file, domain), start=1):
                _write(data, count - 1, one, spec, layout)
            metadata = _metadata(spec, layout, as_name(out.name))
            (data / METADATA).write_text(json.dumps({"total_episodes": count, "total_steps": steps, **metadata}))
        return ["units of keys"]


class _HDF5Episodes:
    """Episodes of the HDF5 layout."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self.file, self.path, self.files = file, path, [path]
        self.numbers = sorted(int(n[8:]) for n in file if n.startswith("episode_") and n[8:].isdecimal())

    def place(self, number: int) -> Path:
        return self.path

    def options(self, number: int) -> dict[str, Any]:
        group = self.file[f"episode_{number}"]
        found = {name[8:]: text_attribute(group, name) for name in group.attrs if name.startswith("options/")}
        success = group.attrs.get(f"options/{SUCCESS}")
        told = {} if success is None else {SUCCESS: bool(success)}
        return {"seed": integer_attribute(group, "seed"), "options": {**found, **told}}

    def infos(self) -> list[str]:
        group = self.file[f"episode_{self.numbers[0]}"]
        return [*group["infos"]] if isinstance(group.get("infos"), h5py.Group) else []

    def numbers_of(self, number: int, name: str) -> np.ndarray:
        return find_numbers(self.file[f"episode_{number}"], name, self.path, (None, None))

    def values(self, number: int, leaf: Leaf) -> Values:
        array = find_array(self.file[f"episode_{number}"], "/".join(("observations", *leaf.hdf5_path)), self.path)
        if leaf.image:
            return self._frames(number, array, leaf)
        values: np.ndarray = array[()] if h5py.check_string_dtype(array.dtype) is None else texts(array)
        return values

    def info(self, number: int, name: str) -> np.ndarray:
        array = find_array(self.file[f"episode_{number}"], f"infos/{name}", self.path)
        values: np.ndarray = array[()] if h5py.check_string_dtype(array.dtype) is None else texts(array)
        return values

    def _frames(self, number: int, array: h5py.Dataset, leaf: Leaf) -> Frames:
        place = f"{self.path}: episode_{number}, {leaf.name}"
        read = partial(_jpegs, array, leaf, place) if leaf.jpeg else partial(iter, array)
        return Frames((len(array), *leaf.shape), read, place)


def _jpegs(array: h5py.Dataset, leaf: Leaf, place: str) -> Iterator[np.ndarray]:
    for step in range(len(array)):
        yield decode(np.asarray(array[step], np.uint8).tobytes(), leaf.shape, f"{place}, step {step}")


class _MinariSource(Source):
    def __init__(self, data: Path, metadata: dict[str, Any], layout: _HDF5Episodes | ArrowEpisodes) -> None:
        self.data, self.metadata, self.layout, place = data, metadata, layout, data / METADATA
        found = find_leaves(_space(metadata, "observation_space", place), place, _jpeg(metadata))
        self.leaves = {leaf.name: leaf for leaf in found}
        if not layout.numbers:
            refuse_source(data, "no episode", "at least one")
        self.description = self._describe(data / METADATA)

    def _describe(self, place: Path) -> SourceDescription:
        low, high, size = limits_of(_space(self.metadata, "action_space", place), place)
        infos = [SourceKey(f"infos.{name}", (), aside=True) for name in self.layout.infos()]
        return SourceDescription(
            place=self.data,
            files=[place, *self.layout.files],
            keys=[*(SourceKey(k.name, k.shape, k.image, k.aside) for k in self.leaves.values()), *infos],
            action_size=size,
            episodes=entry(self.metadata, "total_episodes", int, place),
            action_low=low,
            action_high=high,
            env=_env(self.metadata),
            dropped=dict.fromkeys(("rewards", "terminations", "truncations"), "our demonstrations have none"),
            warnings=[*self._warnings()],
        )

    def _warnings(self) -> Iterator[str]:
        lossy = [leaf.name for leaf in self.leaves.values() if leaf.image and leaf.jpeg]
        if lossy:
            yield f"images of {', '.join(lossy)} were stored as JPEG, with loss: colours are not exact"
        if SUCCESS not in self.layout.options(self.layout.numbers[0])["options"]:
            yield NO_SUCCESS

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        for number in self.layout.numbers:
            told, options = self.layout.options(number), self.layout.options(number)["options"]
            values = {key: self._values(number, key) for key in keys}
            actions = self.layout.numbers_of(number, "actions")
            task, success = options.get("task"), options.get(SUCCESS)
            yield SourceEpisode(
                *(f"episode_{number}", self.layout.place(number), values, actions),
                task=task if isinstance(task, str) else self.description.env or None,
                seed=told["seed"] if isinstance(told["seed"], int) else None,
                success=success if isinstance(success, bool) else None,
            )

    def _values(self, number: int, key: str) -> Values:
        if key.startswith("infos.") and key not in self.leaves:
            return self.layout.info(number, key.removeprefix("infos."))
        return self.layout.values(number, self.leaves[key])


def _space(metadata: dict[str, Any], name: str, place: Path) -> dict[str, Any]:
    return parse_object(entry(metadata, name, str, place), f"{place}: {name}")


def _jpeg(metadata: dict[str, Any]) -> bool:
    return metadata.get("jpeg_encoding", True) is not False


def _env(metadata: dict[str, Any]) -> str:
    found = metadata.get("dataset_id")
    return found if isinstance(found, str) and found.isprintable() else ""


def _metadata(spec: DomainSpec, layout: str, name: str) -> dict[str, Any]:
    keys = {key.name: box(key.shape, np.uint8 if key.kind == "image" else np.float32) for key in spec.observation}
    kind = np.float32 if spec.action_low is None else np.float64
    limits = [[*limit] for limit in spec.action_limits]
    return {
        "data_format": layout,
        "jpeg_encoding": False,  # understood from Minari 0.5.4 on
        "observation_space": json.dumps({"type": "Dict", "subspaces": keys}),
        "action_space": json.dumps(box((spec.action_size,), kind, *limits)),
        "dataset_id": f"plp/{name}-v0",
        "minari_version": "0.5.4",
    }


def _write(data: Path, number: int, one: Demonstration, spec: DomainSpec, layout: str) -> None:
    arrays, values = _arrays(one, spec), one.values(spec)
    told = {"id": number, "seed": one.seed, "total_steps": len(one.actions)}
    options = {"task": one.task, SUCCESS: one.success}
    if layout == "arrow":
        write_episode(data, number, values, arrays, {**told, "options": options})
        return
    with h5py.File(data / MAIN, "a", libver=("earliest", "v110"), track_order=True) as file:
        group = file.create_group(f"episode_{number}")
        for name, array in (arrays | {f"observations/{name}": array for name, array in values.items()}).items():
            group.create_dataset(name, data=array, compression=cast("Any", "gzip" if array.ndim > 2 else None))
        group.attrs.update(told | {f"options/{name}": value for name, value in options.items()})


def _arrays(one: Demonstration, spec: DomainSpec) -> dict[str, np.ndarray]:
    """Arrays ``(T, …)`` beside the observations."""
    ends = np.zeros(len(one.actions), np.bool_)
    ends[-1] = True
    return {
        "actions": spec.owner_actions(one.actions),
        "rewards": ends * np.float32(one.success),
        "terminations": ends & one.success,
        "truncations": ends & (not one.success),
    }
