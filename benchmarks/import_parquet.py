"""Time and memory of importing a LeRobot dataset of vectors, v3.0 as its own package writes it.

    python benchmarks/import_parquet.py [--steps 1000000] [--folder FOLDER]

One process writes the dataset, another imports it; the second's time and greatest memory are told, and what the
process had in memory before it began. Memory holds the vectors of our file a few times over, whatever the source's
size in images and other columns.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

EPISODE, FILE_EPISODES, STATE, ACTION, HZ = 200, 1000, 14, 7, 50
PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


def write_source(root: Path, steps: int) -> None:
    episodes = steps // EPISODE
    (root / "meta/episodes/chunk-000").mkdir(parents=True)
    (root / "data/chunk-000").mkdir(parents=True)
    single = ("timestamp", "frame_index", "episode_index", "index", "task_index")
    features = {n: {"dtype": "float32", "shape": [s]} for n, s in (("observation.state", STATE), ("action", ACTION))}
    features |= {name: {"dtype": "int64", "shape": [1]} for name in single}
    info = {"codebase_version": "v3.0", "fps": HZ, "features": features, "data_path": PATH, "total_episodes": episodes}
    (root / "meta/info.json").write_text(json.dumps(info))
    pq.write_table(pa.table({"task_index": [0], "task": ["put it down"]}), root / "meta/tasks.parquet")
    places = {"episode_index": range(episodes), "length": [EPISODE] * episodes, "data/chunk_index": [0] * episodes}
    table = pa.table({k: [*v] for k, v in places.items()} | {"data/file_index": np.arange(episodes) // FILE_EPISODES})
    pq.write_table(table, root / "meta/episodes/chunk-000/file-000.parquet")
    for first in range(0, episodes, FILE_EPISODES):
        path = root / PATH.format(chunk_index=0, file_index=first // FILE_EPISODES)
        write_table(path, range(first, min(episodes, first + FILE_EPISODES)))


def write_table(path: Path, episodes: range) -> None:
    """A row group an episode, as LeRobot writes them."""
    writer, random = None, np.random.default_rng(episodes.start)
    for episode in episodes:
        vectors = {
            "observation.state": random.normal(size=(EPISODE, STATE)),
            "action": random.normal(size=(EPISODE, ACTION)),
        }
        columns = {name: pa.FixedSizeListArray.from_arrays(pa.array(v.astype(np.float32).ravel()), v.shape[1])
                   for name, v in vectors.items()}  # fmt: skip
        steps = np.arange(EPISODE)
        columns |= {"timestamp": pa.array((steps / HZ).astype(np.float32)), "frame_index": pa.array(steps)}
        columns |= {"episode_index": pa.array(np.full(EPISODE, episode)), "index": pa.array(steps + episode * EPISODE)}
        table = pa.table(columns | {"task_index": pa.array(np.zeros(EPISODE, np.int64))})
        writer = writer or pq.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()


def import_source(root: Path, out: Path) -> None:
    from plp_lightning.cli.main import main

    before, start = megabytes(), time.perf_counter()
    main(["data", "import", "lerobot", str(root), "--domain", "arm", "--out", str(out)])
    seconds = time.perf_counter() - start
    size = out.stat().st_size / 1e6
    print(f"{seconds:.1f} s; {megabytes():.0f} MB at most, {before:.0f} MB before; our file: {size:.0f} MB")


def megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("--only_import", action="store_true", help="of the dataset that is in the folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        if options.only_import:
            import_source(folder / "source", Path(temporary) / "ours.hdf5")
            return
        write_source(folder / "source", options.steps)
        size = sum(path.stat().st_size for path in (folder / "source").rglob("*.parquet"))
        print(f"{options.steps} steps, {size / 1e6:.0f} MB of Parquet", flush=True)
        subprocess.run([sys.executable, __file__, "--only_import", "--folder", str(folder)], check=True)


if __name__ == "__main__":
    main()
