"""Makes ``minari_hdf5``, ``minari_arrow``, ``minari_lossless`` and ``minari_parquet`` beside it.

pip install 'minari[hdf5,arrow]==0.5.4' && python make_minari.py
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import golden_values
import numpy as np

HERE = Path(__file__).parent


def buffers(keys: tuple[str, ...] | None) -> list:
    """Episodes seen by these cameras; by the place of the hand alone, as one array, if None."""
    from minari.data_collector import EpisodeBuffer

    made = []
    for number, one in enumerate(golden_values.episodes()):
        ends = np.arange(len(one.actions)) == len(one.actions) - 1
        seen = {"robot": {k: one.seen[k] for k in golden_values.KEYS}, **{k: one.seen[k] for k in keys or ()}}
        made.append(
            EpisodeBuffer(
                id=number,
                seed=one.seed,
                options={"task": one.task},
                observations=one.seen["ee_pos"] if keys is None else seen,
                actions=one.actions,
                rewards=ends.astype(np.float32),
                terminations=ends,
                truncations=np.zeros_like(ends),
                infos={"goal": np.full(len(ends) + 1, number % 2)},
            )
        )
    return made


def main() -> None:
    os.environ["MINARI_DATASETS_PATH"] = root = tempfile.mkdtemp()
    import gymnasium
    import minari

    robot = {k: gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32) for k, shape in golden_values.KEYS.items()}
    limits = gymnasium.spaces.Box(golden_values.LOW, golden_values.HIGH, (2,), np.float32)
    cameras = {k: gymnasium.spaces.Box(0, 255, shape, np.uint8) for k, shape in golden_values.CAMERAS.items()}
    everything = gymnasium.spaces.Dict({"robot": gymnasium.spaces.Dict(robot), **cameras})
    for name, layout, jpeg in (
        ("hdf5", "hdf5", True),
        ("arrow", "arrow", True),
        ("lossless", "hdf5", False),
        ("parquet", "parquet", True),
    ):
        plain = name == "parquet"
        minari.create_dataset_from_buffers(
            f"golden/{name}-v0",
            buffer=buffers(None if plain else (*cameras,)),
            observation_space=robot["ee_pos"] if plain else everything,
            action_space=limits,
            algorithm_name="made up",
            data_format=layout,
            jpeg_encoding=jpeg,
        )
        target = HERE / f"minari_{name}"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(Path(root) / f"golden/{name}-v0", target)


if __name__ == "__main__":
    main()
