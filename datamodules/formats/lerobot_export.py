"""Demonstrations → LeRobot's datasets v2.1 and v3.0; images as PNG in the tables, without loss."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.formats.exporting import Demonstration, demonstrations, new_folder
from datamodules.formats.frames import encode_png
from datamodules.formats.lerobot_stats import Summary, summarise
from datamodules.formats.parquet import extra
from datamodules.store.reader import TrajectoryFile
from datamodules.types import DomainSpec

CHUNK = 1000
FILE_BYTES = 100 * 2**20  # Of a table in v3.0, after which another begins
SUCCESS = "next.success"
PATHS = {
    "2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    "3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
}


def write_dataset(file: TrajectoryFile, domain: str, out: Path, version: str) -> Sequence[str]:
    """Write a dataset, its state ``(T, O)`` one vector; tell what of the domain has no place in it."""
    spec, table = file.spec(domain), file.episodes(domain)
    with new_folder(out) as root:
        (root / "meta").mkdir()
        writer = _Writer(root, spec, file.tasks, version)
        for one in demonstrations(file, domain):
            writer.add(one)
        writer.finish()
    last = [f"last observations of {n} demonstrations" for n in [int((table.last >= 0).sum())] if n]
    return [*last, "units of keys", "names of state keys: they are one vector, observation.state"]


class _Writer:
    """Writes tables and metadata of one dataset.

    Args:
        root: New folder of the dataset.
        spec: The domain.
        tasks: All tasks, in order.
        version: ``2.1`` or ``3.0``.
    """

    def __init__(self, root: Path, spec: DomainSpec, tasks: Sequence[str], version: str) -> None:
        self.root, self.spec, self.tasks, self.version = root, spec, tasks, version
        self.features = _features(spec)
        self.episodes: list[dict[str, Any]] = []
        self.summaries: list[dict[str, Summary]] = []
        self.rows, self.file = 0, 0
        self.writer: Any = None

    def add(self, one: Demonstration) -> None:
        """Add an episode."""
        number, steps = len(self.episodes), len(one.actions)
        columns = self._columns(one, number)
        path = self._path(number)
        self._append(path, _arrow_table(columns, self.features))
        place = {"data/chunk_index": self.file // CHUNK, "data/file_index": self.file % CHUNK}
        rows = {"dataset_from_index": self.rows, "dataset_to_index": self.rows + steps}
        told = {"episode_index": number, "tasks": [one.task], "length": steps, "seed": one.seed}
        self.episodes.append(told | (place | rows if self.version == "3.0" else {}))
        self.summaries.append({name: summarise(values) for name, values in columns.items()})
        self.rows += steps
        if self.version == "2.1" or path.stat().st_size >= FILE_BYTES:
            self._close()

    def finish(self) -> None:
        """Write the metadata."""
        self._close()
        meta = self.root / "meta"
        (meta / "info.json").write_text(json.dumps(self._info(), indent=4))
        if self.version == "2.1":
            tasks = ({"task_index": i, "task": task} for i, task in enumerate(self.tasks))
            stats = ({"episode_index": i, "stats": _plain(s)} for i, s in enumerate(self.summaries))
            for name, records in (("tasks", tasks), ("episodes", self.episodes), ("episodes_stats", stats)):
                (meta / f"{name}.jsonl").write_text("".join(f"{json.dumps(record)}\n" for record in records))
            return
        _write_tasks(meta / "tasks.parquet", self.tasks)
        (meta / "episodes/chunk-000").mkdir(parents=True)
        table = extra("pyarrow").Table.from_pylist(self.episodes)
        extra("pyarrow.parquet").write_table(table, meta / "episodes/chunk-000/file-000.parquet")
        if self.summaries:
            joined = {n: sum((s[n] for s in self.summaries[1:]), self.summaries[0][n]) for n in self.features}
            (meta / "stats.json").write_text(json.dumps(_plain(joined), indent=4))

    def _columns(self, one: Demonstration, number: int) -> dict[str, np.ndarray]:
        steps = np.arange(len(one.actions))
        columns = {"observation.state": one.state[: len(steps)]} if self.spec.state_keys else {}
        columns["action"] = self.spec.owner_actions(one.actions)
        columns |= {_camera(name): images[: len(steps)] for name, images in one.images.items()}
        return columns | {
            SUCCESS: (steps == steps[-1]) & one.success,
            "timestamp": (steps / self.spec.control_hz).astype(np.float32),
            "frame_index": steps,
            "episode_index": np.full_like(steps, number),
            "index": steps + self.rows,
            "task_index": np.full_like(steps, self.tasks.index(one.task)),
        }

    def _path(self, number: int) -> Path:
        place = number if self.version == "2.1" else self.file
        name = f"episode_{number:06d}" if self.version == "2.1" else f"file-{place % CHUNK:03d}"
        return self.root / f"data/chunk-{place // CHUNK:03d}/{name}.parquet"

    def _append(self, path: Path, table: Any) -> None:
        if self.writer is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.writer = extra("pyarrow.parquet").ParquetWriter(path, table.schema)
        self.writer.write_table(table)

    def _close(self) -> None:
        if self.writer is not None:
            self.writer.close()
            self.writer, self.file = None, self.file + 1

    def _info(self) -> dict[str, Any]:
        count, hz = len(self.episodes), self.spec.control_hz
        info = {
            "codebase_version": f"v{self.version}",
            "robot_type": self.spec.env or self.spec.name,
            "total_episodes": count,
            "total_frames": self.rows,
            "total_tasks": len(self.tasks),
            "chunks_size": CHUNK,
            "fps": int(hz) if hz == int(hz) else hz,
            "splits": {"train": f"0:{count}"},
            "data_path": PATHS[self.version],
            "video_path": None,
            "features": self.features,
        }
        old, new = {"total_videos": 0, "total_chunks": -(-count // CHUNK)}, {"data_files_size_in_mb": 100}
        return info | (old if self.version == "2.1" else new)


def _camera(name: str) -> str:
    return f"observation.images.{name.removeprefix('observation.images.')}"


def _features(spec: DomainSpec) -> dict[str, dict[str, Any]]:
    """Features in LeRobot's words; the limits of the actions are ours, and others look past them."""
    parts = [f"{key.name}_{i}" for key in spec.state_keys for i in range(key.shape[0])]
    kind = "float32" if spec.action_low is None else "float64"
    limits = {} if spec.action_low is None else {"low": spec.action_low, "high": spec.action_high}
    action = {"dtype": kind, "shape": [spec.action_size], "names": [f"action_{i}" for i in range(spec.action_size)]}
    state = {"observation.state": {"dtype": "float32", "shape": [spec.state_size], "names": parts}}
    found: dict[str, dict[str, Any]] = {**(state if parts else {}), "action": action | limits}
    for key in spec.image_keys:
        names = ["height", "width", "channels"]
        found[_camera(key.name)] = {"dtype": "image", "shape": [*key.shape], "names": names}
    single = {SUCCESS: "bool", "timestamp": "float32"}
    single |= dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
    return found | {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in single.items()}


def _arrow_table(columns: Mapping[str, np.ndarray], features: Mapping[str, Mapping[str, Any]]) -> Any:
    """One episode as a table, with the schema's metadata by which Hugging Face's ``datasets`` knows images."""
    arrow, arrays, known = extra("pyarrow"), list[Any](), dict[str, dict[str, Any]]()
    for name, values in columns.items():
        kind = features[name]["dtype"]
        value: dict[str, Any] = {"dtype": kind, "_type": "Value"}
        if kind == "image":
            rows = [{"bytes": encode_png(image), "path": None} for image in values]
            fields = [("bytes", arrow.binary()), ("path", arrow.string())]
            arrays.append(arrow.array(rows, arrow.struct(fields)))
            known[name] = {"_type": "Image"}
        elif values.ndim == 1:
            arrays.append(arrow.array(values))
            known[name] = value
        else:
            flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
            arrays.append(arrow.FixedSizeListArray.from_arrays(flat, values.shape[1]))
            known[name] = {"feature": value, "length": values.shape[1], "_type": "Sequence"}
    metadata = {"huggingface": json.dumps({"info": {"features": known}})}
    return arrow.Table.from_arrays(arrays, [*columns]).replace_schema_metadata(metadata)


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Table of the tasks, whose sentences are the index of a pandas frame."""
    columns = {"task_index": [*range(len(tasks))], "task": [*tasks]}
    kinds = {"task_index": "int64", "task": "object"}
    described = [
        {"name": n, "field_name": n, "pandas_type": k.replace("object", "unicode"), "numpy_type": k, "metadata": None}
        for n, k in kinds.items()
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": described, "pandas_version": "2.0.0"}
    table = extra("pyarrow").table(columns).replace_schema_metadata({"pandas": json.dumps(pandas)})
    extra("pyarrow.parquet").write_table(table, path)


def _plain(summaries: Mapping[str, Summary]) -> dict[str, dict[str, Any]]:
    return {name: summary.plain() for name, summary in summaries.items()}
