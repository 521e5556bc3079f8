"""LeRobot's datasets v2.0, v2.1 and v3.0: Parquet tables, tasks as sentences, cameras as images or videos.

See https://huggingface.co/docs/lerobot/lerobot-dataset-v3. T rows for T actions: what was seen last is unknown.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from datamodules.formats.frames import Frames, image_shape
from datamodules.formats.lerobot_export import write_dataset
from datamodules.formats.lerobot_meta import Episode, find_episodes, find_tasks
from datamodules.formats.metadata import entry, read_object
from datamodules.formats.parquet import batches
from datamodules.formats.parquet_images import read_images
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
from datamodules.formats.video import Clip, read_clip
from datamodules.store.reader import TrajectoryFile

VERSIONS = ("v2.0", "v2.1", "v3.0")
BOOKKEEPING = ("timestamp", "frame_index", "episode_index", "index", "task_index")
NUMBERS = ("float16", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "bool")
READ = ("episode_index", "frame_index", "task_index")
SUCCESS = "next.success"


class LeRobot(Format):
    """LeRobot's datasets.

    Args:
        action: Column with the actions.
    """

    title = "a LeRobot dataset"

    def __init__(self, action: str = "action") -> None:
        self.action = action

    @contextmanager
    def open(self, path: Path) -> Iterator[Source]:
        yield _LeRobotSource(path, self.action)

    def write(
        self, file: TrajectoryFile, domain: str, out: Path, version: Literal["3.0", "2.1"] = "3.0"
    ) -> Sequence[str]:
        """Write a dataset, its state ``(T, O)`` one vector.

        Args:
            file: Our file.
            domain: The domain.
            out: Folder of the new dataset.
            version: Version of the dataset; LeRobot from 0.4 on reads 3.0 alone, before it 2.1 alone.
        """
        return write_dataset(file, domain, out, version)


class _LeRobotSource(Source):
    def __init__(self, root: Path, action: str) -> None:
        self.root, self.action, place = root, action, root / "meta/info.json"
        info = read_object(place)
        version = entry(info, "codebase_version", str, place)
        if version not in VERSIONS:
            refuse_source(place, f"codebase_version {version[:50]!r}", f"one of {', '.join(VERSIONS)}")
        features = entry(info, "features", dict, place)
        self.keys = {name: _key(str(name), feature, place) for name, feature in features.items()}
        self.videos = [name for name, feature in features.items() if feature["dtype"] == "video"]
        if action not in self.keys or len(self.keys[action].shape) != 1:
            refuse_source(place, f"no vector {action!r} among the features", "actions: name them by --action")
        self.fps = entry(info, "fps", float, place)
        self.tasks = find_tasks(root, version)
        self.table = [*find_episodes(root, info, version, self.videos)]
        self.description = self._describe(info, features[action], place)

    def _describe(self, info: dict[str, Any], action: Mapping[str, Any], place: Path) -> SourceDescription:
        seen = [key for name, key in self.keys.items() if name not in (*BOOKKEEPING, self.action)]
        env, files = info.get("robot_type"), {path for episode in self.table for path in episode.files}
        low, high = (_limits(action.get(name), self.keys[self.action].shape[0]) for name in ("low", "high"))
        video = [f"images of {', '.join(self.videos)} come from videos, with loss: colours are not exact"]
        told = [] if SUCCESS in self.keys else [NO_SUCCESS]
        return SourceDescription(
            place=self.root,
            files=[
                *sorted(path for path in self.root.glob("meta/**/*") if path.is_file()),
                *sorted(filter(Path.is_file, files)),
            ],
            keys=seen,
            action_size=self.keys[self.action].shape[0],
            episodes=max(entry(info, "total_episodes", int, place), len(self.table)),
            fps=self.fps,
            action_low=low if high else None,
            action_high=high if low else None,
            env=env if isinstance(env, str) and env.isprintable() else "",
            dropped={"timestamp, frame_index, index": "they follow from the rate"},
            warnings=[*(video if self.videos else []), *told],
        )

    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        vectors = [key for key in keys if not self.keys[key].image]
        success = [SUCCESS] if SUCCESS in self.keys else []
        columns = [*dict.fromkeys([*READ, self.action, *vectors, *success])]
        for path, episodes in itertools.groupby(self.table, key=lambda episode: episode.path):
            if path.is_file():
                yield from self._in_file(path, {e.number: e for e in episodes}, keys, columns)

    def _in_file(
        self, path: Path, episodes: Mapping[int, Episode], keys: Sequence[str], columns: Sequence[str]
    ) -> Iterator[SourceEpisode]:
        row = 0
        for values in _runs(path, columns):
            index, start, steps = int(values["episode_index"][0]), row, len(values["frame_index"])
            row += steps
            if index not in episodes:
                continue
            place = f"{path}: episode {index}"
            if steps != episodes[index].length:
                refuse_source(place, f"{steps} rows", f"{episodes[index].length}, as its metadata say")
            strange = np.flatnonzero(values["frame_index"].ravel() != np.arange(steps))
            if len(strange):
                at = int(strange[0])
                refuse_source(f"{place}, frame_index, step {at}", f"{values['frame_index'].ravel()[at]}", f"{at}")
            yield self._episode(path, episodes[index], keys, values, start)

    def _episode(
        self, path: Path, episode: Episode, keys: Sequence[str], values: Mapping[str, np.ndarray], row: int
    ) -> SourceEpisode:
        name, tasks = f"episode {episode.number}", np.unique(values["task_index"])
        seen = {key: self._values(path, episode, key, values, row) for key in keys}
        success = bool(values[SUCCESS].any()) if SUCCESS in values else None
        task = self.tasks.get(int(tasks[0])) if len(tasks) == 1 else None
        actions = _shaped(values[self.action], self.keys[self.action], f"{path}: {name}")
        return SourceEpisode(name, path, seen, actions, task, episode.seed, success)

    def _values(self, path: Path, episode: Episode, key: str, values: Mapping[str, np.ndarray], row: int) -> Values:
        place, shape = f"{path}: episode {episode.number}, {key}", self.keys[key].shape
        if not self.keys[key].image:
            return _shaped(values[key], self.keys[key], f"{path}: episode {episode.number}")
        if key in self.videos:
            video, start = episode.videos[key]
            read = partial(read_clip, Clip(video, start, self.fps, episode.length), shape, place)
        else:
            read = partial(read_images, path, key, (row, row + episode.length), shape, place)
        return Frames((episode.length, *shape), read, place)


def _runs(path: Path, columns: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    """Columns ``(T, …)`` of one episode after the other; a long one may come in several batches."""
    held: list[dict[str, np.ndarray]] = []
    for batch in batches(path, columns):
        index = batch["episode_index"] = batch["episode_index"].reshape(-1)
        cuts = [0, *(np.flatnonzero(np.diff(index)) + 1).tolist(), len(index)]
        for start, stop in itertools.pairwise(cuts):
            if held and start < stop and held[0]["episode_index"][0] != index[start]:
                yield _joined(held)
                held = []
            if start < stop:
                held.append({name: values[start:stop] for name, values in batch.items()})
    if held:
        yield _joined(held)


def _joined(pieces: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    names = pieces[0]
    return {n: pieces[0][n] if len(pieces) == 1 else np.concatenate([piece[n] for piece in pieces]) for n in names}


def _shaped(values: np.ndarray, key: SourceKey, place: str) -> np.ndarray:
    shape = (len(values), *key.shape)
    if values.size != np.prod(shape, dtype=np.int64):
        refuse_source(f"{place}, {key.name}", f"{values.shape[1:]} values a step", f"{key.shape}, as info.json says")
    return values.reshape(shape)


def _key(name: str, feature: Any, place: Path) -> SourceKey:
    if not isinstance(feature, dict):
        refuse_source(place, f"feature {name[:50]!r} that is no object", "dtype, shape and names")
    kind, shape = entry(feature, "dtype", str, f"{place}: {name}"), entry(feature, "shape", list, f"{place}: {name}")
    if not all(type(n) is int and 0 < n < 2**31 for n in shape):
        refuse_source(f"{place}: {name}", f"the shape {str(shape)[:100]}", "positive numbers")
    if kind not in ("image", "video"):
        aside = kind not in NUMBERS or not name.startswith("observation")
        return SourceKey(name, tuple(shape), aside=aside)
    names = feature.get("names")
    first = names[0] if isinstance(names, list) and names else ""
    size = tuple([*shape[1:], shape[0]] if str(first).startswith("channel") else shape)
    if not image_shape(size):
        refuse_source(f"{place}: {name}", f"images of shape {size}", "(height, width, channels)")
    return SourceKey(name, size, image=True)


def _limits(values: Any, size: int) -> tuple[float, ...] | None:
    fits = isinstance(values, list) and len(values) == size and all(type(v) in (int, float) for v in values)
    return tuple(map(float, values)) if fits else None
