"""Options of an import that do not fit its source end in one line, and leave nothing behind."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from command import complaint, plp
from foreign import FRONT, GOLDEN, nothing, refused


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--state", "observation.stat"], "--state: found no 'observation.stat' (did you mean 'observation.state'?)"),
        (["--state", FRONT], f"--state: found no '{FRONT}'"),
        (["--rename", "x=y"], "--rename: found no 'x'; expected one of: observation.state"),
        (["--rename", "observation.state=a b"], "expected OLD=NEW"),
        (["--task_key", "goal"], "--task_key: found no 'goal'; expected one of: observation.state"),
        (["--task_key", "frame_index"], "--task_key: found no 'frame_index'"),
        (["--task_key", "observation.state"], "step 0: found values of shape (4, 5); expected one text or number"),
        (["--task_map", "nowhere.json"], "nowhere.json: found no such file"),
        (["--first_seed", -1], "--first_seed is -1; expected a whole number from 0"),
        (["--first_seed", 2**63], "expected a whole number from 0 to 4294967295"),
        (["--action_low", "nan", "--action_high", 1], "action limits (nan, nan) to (1.0, 1.0); expected 2 finite"),
        (["--action_low", -1], "one of --action_low and --action_high is missing"),
        (["--action_low", -1, -1, -1, "--action_high", 2.5], "3 numbers limit 2 actions; expected as many, or one"),
        (
            ["--action_low", 3, "--action_high", 2.5],
            "action limits (3.0, 3.0) to (2.5, 2.5); expected 2 finite numbers",
        ),
        (["--action_low", -1, "--action_high", 1], "in component 1; expected -1 to 1: state --action_low and"),
        (["--fps", 0], "found 0 steps a second; expected a positive number"),
        (["--fps", "nan"], "found nan steps a second; expected a positive number"),
        (["--resize", 3], "--resize is 3; expected height and width in pixels"),
        (["--resize", -1, 4], "--resize is -1 4; expected height and width in pixels"),
        (["--resize", 10**6, 10**6], "expected height and width in pixels"),
        (["--domain", "a b"], "--domain is 'a b'; expected 1 to 64 letters"),
        (["--action", "observation.image"], "no vector 'observation.image' among the features; expected actions"),
        (["--task", "a\tb"], "task: found 'a\\tb'; expected printable text"),
    ],
    ids=str,
)
def test_options_that_do_not_fit(tmp_path: Path, options: list[object], told: str) -> None:
    assert told in refused(tmp_path, "lerobot", nothing, *options)


def test_a_map_of_tasks_that_nobody_has(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text('{"lift the lit": "lift"}')
    told = refused(tmp_path, "lerobot", nothing, "--task_map", tmp_path / "map.json")
    assert "map.json: found no 'lift the lit' (did you mean 'lift the lid'?)" in told


def test_unknown_formats_are_told_those_there_are() -> None:
    told = complaint("data", "import", "lerobott", "x", "--domain", "a", "--out", "y")
    assert "format: found no 'lerobott' (did you mean 'lerobot'?); expected one of: robomimic, lerobot, minari" in told


def test_sources_of_two_robots_are_told_apart(tmp_path: Path) -> None:
    def grow(root: Path) -> None:
        with h5py.File(root, "r+") as file:
            for group in file["data"].values():
                for place in ("obs", "next_obs"):
                    values = group[f"{place}/ee_pos"][()]
                    del group[f"{place}/ee_pos"]
                    group[f"{place}/ee_pos"] = np.repeat(values, 2, axis=1)

    other = tmp_path / "other.hdf5"
    shutil.copy(GOLDEN / "robomimic.hdf5", other)
    grow(other)
    words = ["--domain", "arm", "--out", tmp_path / "x.hdf5", "--task", "push", "--without_images"]
    told = complaint("data", "import", "robomimic", GOLDEN / "robomimic.hdf5", other, *words)
    assert f"{other}: found ee_pos of shape (4,); expected (2,), as in " in told


def test_what_is_there_of_an_incomplete_source_can_be_had(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(GOLDEN / "lerobot_v2_1", copy)
    (copy / "data/chunk-000/episode_000001.parquet").unlink()
    words = ["data", "import", "lerobot", copy, "--domain", "arm", "--out", tmp_path / "x.hdf5", "--without_images"]
    answer = plp(*words, "--incomplete")
    assert "3 demonstrations of 2 tasks imported" in answer.out
    assert (tmp_path / "x.hdf5").exists()
