"""What may befall files of other projects: golden ones are copied, changed and imported."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from command import complaint

GOLDEN = Path(__file__).parent / "datamodules" / "golden"
SOURCES = {
    "robomimic": "robomimic.hdf5",
    "minari": "minari_hdf5",
    "arrow": "minari_arrow",
    "lerobot": "lerobot_v3_0",
    "old": "lerobot_v2_1",
    "video": "lerobot_v3_0_video",
}
FORMS = {"arrow": "minari", "old": "lerobot", "video": "lerobot"}
GIVEN = {"minari": ["--fps", 10], "arrow": ["--fps", 10]}


def nothing(root: Path) -> None:
    """Leaves a source as it is."""


def refused(
    tmp_path: Path, name: str, befall: Callable[[Path], None], *options: object, image: str | None = None
) -> str:
    """Copies a golden source, lets something befall it, imports it and gives the complaint."""
    golden, copy, out = GOLDEN / SOURCES[name], tmp_path / SOURCES[name], tmp_path / "out" / "x.hdf5"
    (shutil.copytree if golden.is_dir() else shutil.copy)(golden, copy)
    befall(copy)
    seen = ["--without_images"] if image is None else ["--image", image]
    words = ["data", "import", FORMS.get(name, name), copy, "--domain", "arm", "--out", out]
    told = complaint(*words, *GIVEN.get(name, []), *seen, *options)
    assert not out.exists()
    return told


def edit(path: str, **changes: Any) -> Callable[[Path], None]:
    """Changes entries of a JSON file; None removes one."""

    def change(root: Path) -> None:
        content = json.loads((root / path).read_text())
        (root / path).write_text(json.dumps({k: v for k, v in (content | changes).items() if v is not None}))

    return change


def write(path: str, content: bytes | str) -> Callable[[Path], None]:
    data = content.encode() if isinstance(content, str) else content
    return lambda root: (root / path if path else root).write_bytes(data) and None


def cut(path: str) -> Callable[[Path], None]:
    """Keeps the first two thirds of a file."""

    def change(root: Path) -> None:
        file = root / path if path else root
        file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])

    return change


def column(path: str, name: str, change_values: Callable[[np.ndarray], Any]) -> Callable[[Path], None]:
    """Replaces a column of numbers in a Parquet file."""

    def change(root: Path) -> None:
        table = pq.read_table(root / path)
        place = table.schema.names.index(name)
        values = change_values(np.array(table.column(name).to_pylist()))
        kind = table.schema.field(name).type
        made = values if isinstance(values, pa.Array) else pa.array(values.tolist(), kind)
        pq.write_table(table.set_column(place, pa.field(name, made.type), made), root / path)

    return change


def hdf5(change_file: Callable[[h5py.File], None], path: str = "") -> Callable[[Path], None]:
    def change(root: Path) -> None:
        with h5py.File(root / path if path else root, "r+") as file:
            change_file(file)

    return change


def put(name: str, values: Any) -> Callable[[Path], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = values

    return hdf5(change)


def nested(levels: int) -> str:
    space: dict[str, Any] = {"type": "Dict", "subspaces": {}}
    for _ in range(levels):
        space = {"type": "Dict", "subspaces": {"a": space}}
    return json.dumps(space)


INFO, DATA = "meta/info.json", "data/chunk-000/file-000.parquet"
EPISODES, MINARI = "meta/episodes/chunk-000/file-000.parquet", "data/main_data.hdf5"
VIDEO = "videos/observation.images.front/chunk-000/file-000.mp4"
FRONT = "observation.images.front"


def late(step: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values[step, 1] = value
        return values

    return change
