"""Files of other projects that are not what they say end in one line that names the file, and leave nothing behind."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pytest
from command import complaint
from foreign import (
    DATA,
    EPISODES,
    FRONT,
    INFO,
    MINARI,
    VIDEO,
    column,
    cut,
    edit,
    hdf5,
    late,
    nested,
    put,
    refused,
    write,
)
from PIL import Image


@pytest.mark.parametrize(
    ("name", "befall", "told"),
    [
        # Fewer demonstrations than promised
        ("robomimic", hdf5(lambda f: f["data"].attrs.update(total=999)), "found 22 steps in all demonstrations of 999"),
        ("minari", edit("data/metadata.json", total_episodes=1000), "found 4 demonstrations of 1000; expected all"),
        ("arrow", lambda root: shutil.rmtree(root / "data/2"), "found 3 demonstrations of 4; expected all of them"),
        ("lerobot", edit(INFO, total_episodes=1000), "found 4 demonstrations of 1000; expected all of them"),
        ("old", lambda r: (r / "data/chunk-000/episode_000001.parquet").unlink(), "found 3 demonstrations of 4"),
        ("lerobot", lambda root: (root / DATA).unlink(), "found 0 demonstrations of 4"),
        # Values that cannot be
        ("lerobot", column(DATA, "action", late(5, np.nan)), "episode 1, actions, step 1: found ["),
        (
            "lerobot",
            column(DATA, "observation.state", late(9, np.inf)),
            "episode 2, observation.state, step 0: found [",
        ),
        ("robomimic", put("data/demo_2/obs/ee_pos", np.zeros((6, 3))), "/data/demo_2/next_obs/ee_pos of shape"),
        ("robomimic", put("data/demo_1/actions", np.zeros((5, 3))), "demo_1, actions: found shape (5, 3)"),
        ("robomimic", put("data/demo_1/actions", np.zeros((4, 2))), "demo_1: found 4 steps of actions; expected num_s"),
        (
            "robomimic",
            put("data/demo_3/actions", np.full((7, 2), 1.2)),
            "step 0: found 1.2 in component 0; expected -1 to 1: add --raw",
        ),
        (
            "minari",
            hdf5(lambda f: f["episode_1/actions"].resize((3, 2)), MINARI),
            "episode_1, robot.ee_pos: found shape (6, 2) for 3",
        ),
        ("lerobot", column(DATA, "frame_index", lambda v: v[::-1]), "episode 0, frame_index, step 0: found 6; expec"),
        (
            "lerobot",
            column(EPISODES, "length", lambda v: v + 1),
            "episode 0: found 4 rows; expected 5, as its metadata",
        ),
        (
            "lerobot",
            column(DATA, "action", lambda v: pa.array([*v[:-1].tolist(), None])),
            "action, row 21: found no va",
        ),
        (
            "lerobot",
            column(DATA, "action", lambda v: pa.array([[1.0], *v[1:].tolist()])),
            "row 1: found 2 values; expec",
        ),
        (
            "lerobot",
            column(DATA, "action", lambda v: pa.array(["x"] * 22)),
            "episode 0, action: found () values a step",
        ),
        ("lerobot", edit(INFO, fps=0), "found 0 steps a second; expected a positive number of them: state it by --fps"),
        (
            "minari",
            edit("data/metadata.json", action_space='{"type": "Discrete", "n": 3}'),
            "an action space of type 'Di",
        ),
        # Metadata that lead astray
        ("lerobot", edit(INFO, data_path="../../{file_index}.parquet"), "expected one inside of this folder"),
        ("lerobot", edit(INFO, data_path="/etc/passwd"), "found the path '/etc/passwd'; expected one inside"),
        (
            "lerobot",
            edit(INFO, data_path="{file_index.__class__}"),
            "found the field {file_index.__class__} in the path",
        ),
        ("lerobot", edit(INFO, data_path="{file_index:099999999d}"), "found 099999999 digits in the path"),
        ("lerobot", edit(INFO, data_path="{file_index!r:>9999}"), "found the field {file_index} in the path"),
        ("old", edit(INFO, data_path="{0}"), "found the field {0} in the path"),
        ("old", edit(INFO, data_path="{"), "in the path '{'"),
        ("old", edit(INFO, chunks_size=0), "found chunks_size 0; expected at least 1"),
        # Metadata that are none
        ("lerobot", edit(INFO, codebase_version="v9"), "found codebase_version 'v9'; expected one of v2.0"),
        ("lerobot", edit(INFO, features=None), "found no 'features'; expected 'features' of type dict"),
        ("lerobot", edit(INFO, features={"action": []}), "found feature 'action' that is no object"),
        ("lerobot", edit(INFO, features={"action": {"dtype": "float32", "shape": [-1]}}), "found the shape [-1]"),
        ("lerobot", edit(INFO, total_episodes="many"), "found 'total_episodes': 'many'; expected"),
        ("lerobot", write(INFO, "[" * 500_000), "found text that is no JSON"),
        ("lerobot", write(INFO, b" " * (17 * 2**20)), "MiB of JSON; expected at most 16"),
        ("lerobot", write(INFO, b"\xff\xfe\x00"), "found text that is no JSON"),
        ("lerobot", write(INFO, "7"), "found a JSON int; expected a JSON object"),
        ("lerobot", write(INFO, '{"fps": ' + "9" * 10_000 + "}"), "found text that is no JSON"),
        ("old", write("meta/episodes.jsonl", '{"episode_index": 0}\n'), "found no 'length'; expected 'length' of type"),
        ("minari", edit("data/metadata.json", observation_space='{"type": "Dict"}'), "no vector to make a state of"),
        ("minari", edit("data/metadata.json", observation_space=nested(9)), "found spaces in spaces, 7 levels"),
        ("minari", edit("data/metadata.json", data_format="zip"), "found data_format 'zip'; expected hdf5, arrow or"),
        ("robomimic", hdf5(lambda f: f["data"].attrs.update(env_args="{")), "env_args: found text that is no JSON"),
        # Files that are damaged or none
        ("robomimic", cut(""), "cannot be read as HDF5"),
        ("robomimic", write("", "{}"), "cannot be read as HDF5"),
        ("minari", cut(MINARI), "cannot be read as HDF5"),
        ("arrow", cut("data/1/part-0.arrow"), "part-0.arrow: found what pyarrow cannot read"),
        ("lerobot", cut(DATA), "file-000.parquet: found what pyarrow cannot read"),
        ("lerobot", cut(EPISODES), "file-000.parquet: found what pyarrow cannot read"),
        ("lerobot", write("meta/tasks.parquet", b""), "tasks.parquet: found what pyarrow cannot read"),
        ("old", lambda root: (root / "meta/tasks.jsonl").unlink(), "tasks.jsonl: found no such file"),
        (
            "robomimic",
            hdf5(lambda f: f.__setitem__("data/demo_9", h5py.ExternalLink("/etc/passwd", "/"))),
            "external li",
        ),
        (
            "robomimic",
            hdf5(lambda f: f["mask"].create_dataset("lost", data=np.array([b"demo_7"]))),
            "demo_7 in mask 'l",
        ),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else None,
)
def test_sources_that_are_not_what_they_say(
    tmp_path: Path, name: str, befall: Callable[[Path], None], told: str
) -> None:
    tasks = ["--task", "push"] if name == "robomimic" else []
    limits = ["--action_low", -1.5, "--action_high", 2.5] if name in ("lerobot", "old") else []
    assert told in refused(tmp_path, name, befall, *tasks, *limits)


@pytest.mark.parametrize(
    ("name", "befall", "told"),
    [
        ("lerobot", column(DATA, FRONT, lambda v: pa.array([{"bytes": None, "path": "/etc/passwd"}] * 22)), "an imag"),
        ("lerobot", column(DATA, FRONT, lambda v: pa.array([{"bytes": b"GIF89a", "path": ""}] * 22)), "step 0: found"),
        ("lerobot", column(DATA, FRONT, lambda v: pa.array([v[0]] * 9 + [{**v[9], "bytes": v[9]["bytes"][:60]}] * 13)),
         "episode 2, observation.images.front, step 0: found"),
        ("video", cut(VIDEO), "found no frame in file-000.mp4"),
        ("video", lambda root: (root / VIDEO).unlink(), "episode 0, observation.images.front: found no file"),
        ("video", write(VIDEO, "#EXTM3U\n/etc/passwd\n"), "found a damaged video"),
        ("video", column(EPISODES, f"videos/{FRONT}/from_timestamp", lambda v: v + 1.5), "found no frame in file"),
        ("video", edit(INFO, fps=20), "found no frame in file-000.mp4; expected 4, as the table has rows"),
        ("video", edit(INFO, video_path="../x.mp4"), "found the path '../x.mp4'; expected one inside of this folder"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else value.__name__,
)  # fmt: skip
def test_images_that_are_not_there(tmp_path: Path, name: str, befall: Callable[[Path], None], told: str) -> None:
    limits = ["--action_low", -1.5, "--action_high", 2.5]
    assert told in refused(tmp_path, name, befall, *limits, image=FRONT)


def test_a_damaged_image_is_laid_to_the_source(tmp_path: Path) -> None:
    def scratch(path: Path) -> None:
        with h5py.File(path) as file:
            place = file["data/demo_2/obs/front"].id.get_chunk_info(0).byte_offset
        content = bytearray(path.read_bytes())
        content[place : place + 20] = b"?" * 20
        path.write_bytes(content)

    told = refused(tmp_path, "robomimic", scratch, "--task", "push", image="front")
    assert f"{tmp_path / 'robomimic.hdf5'}: /data/demo_2/obs/front, step 0: found" in told
    assert "expected undamaged images" in told


def test_a_depth_image_is_none_of_bytes(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    Image.fromarray(np.full((32, 40), 40000, np.uint16)).save(buffer, format="PNG")
    deep = column(DATA, FRONT, lambda v: pa.array([{"bytes": buffer.getvalue(), "path": ""}] * 22))
    told = refused(tmp_path, "lerobot", deep, image=FRONT)
    assert "step 0: found an image of 32 × 40 pixels, I;16; expected 32 × 40 × RGB" in told


@pytest.mark.parametrize(
    ("name", "gone"), [("robomimic", "."), ("minari", "data/main_data.hdf5"), ("d4rl", ".")], ids=str
)
def test_a_source_that_is_missing_is_not_to_be_collected(name: str, gone: str, tmp_path: Path) -> None:
    if name == "d4rl":
        told = complaint("data", "import", name, tmp_path / "x.hdf5", "--domain", "arm", "--out", tmp_path / "y.hdf5")
    else:
        told = refused(tmp_path, name, lambda root: (root / gone).unlink())
    assert "no such file; expected HDF5: check the path\n" in told
