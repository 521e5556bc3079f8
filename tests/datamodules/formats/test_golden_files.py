"""Files that the packages of other projects wrote come in as they were recorded: see ``golden/make_*.py``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from command import plp

from datamodules.store.writer import TrajectoryFile

GOLDEN = Path(__file__).parents[1] / "golden"
sys.path.insert(0, str(GOLDEN))

from golden_values import HIGH, HZ, KEYS, LOW, TASKS, Golden, episodes  # noqa: E402

DARK = ["--without_state"]
LIMITS = ["--action_low", LOW, "--action_high", HIGH]
ROBOT = ["robot.joint_pos", "robot.ee_pos"]
CASES = {
    "robomimic.hdf5": ["robomimic", "--state", *KEYS, *LIMITS],
    "minari_hdf5": ["minari", "--state", *ROBOT, "--fps", HZ],
    "minari_arrow": ["minari", "--state", *ROBOT, "--fps", HZ],
    "minari_lossless": ["minari", "--state", *ROBOT, "--fps", HZ],
    "lerobot_v2_1": ["lerobot", *LIMITS],
    "lerobot_v3_0": ["lerobot", *LIMITS],
    "lerobot_v3_0_video": ["lerobot", *LIMITS],
}
LOSSY = {"minari_hdf5": "stored as JPEG", "minari_arrow": "stored as JPEG", "lerobot_v3_0_video": "come from videos"}


def bring(name: str, out: Path, *options: object) -> str:
    form, *given = CASES[name]
    answer = plp("data", "import", form, GOLDEN / name, "--domain", "arm", "--out", out, *given, *options)
    assert answer.code == 0, answer
    return answer.out


def camera(name: str, which: str) -> str:
    return f"observation.images.{which}" if name.startswith("lerobot") else which


def find(file: TrajectoryFile, one: Golden, number: int):
    """The demonstration in our file; robomimic and LeRobot know no seeds, so they are numbers there."""
    table = file.episodes("arm")
    (row,) = np.flatnonzero((table.seed == one.seed) | (table.seed == number))
    return file.trajectory("arm", row)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("which", ["front", "wrist"])
def test_golden_files_come_in_as_they_were_recorded(tmp_path: Path, name: str, which: str) -> None:
    if (name, which) == ("lerobot_v3_0_video", "wrist"):
        pytest.skip("it has one camera")
    tasks = ["--task", TASKS[0]] if name == "robomimic.hdf5" else []  # its tasks are masks beside train and valid
    out = tmp_path / "x.hdf5"
    told = bring(name, out, "--image", camera(name, which), "--rename", f"{camera(name, which)}=eye", *tasks)
    assert (LOSSY.get(name, "no loss") in told) == (name in LOSSY)
    with TrajectoryFile.open(out) as file:
        spec = file.spec("arm")
        assert (spec.control_hz, spec.action_low, spec.action_high) == (HZ, (LOW,) * 2, (HIGH,) * 2)
        for number, one in enumerate(episodes()):
            found, steps = find(file, one, number), len(one.actions)
            known = steps + (not name.startswith("lerobot"))
            assert found.task == (TASKS[0] if tasks else one.task)
            state = np.concatenate([one.seen[key][:known] for key in KEYS], axis=1)
            np.testing.assert_array_equal(found.observation.state, state)
            middle, reach = (HIGH + LOW) / 2, (HIGH - LOW) / 2
            expected = ((one.actions.astype(np.float64) - middle) / reach).astype(np.float32)
            np.testing.assert_array_equal(found.actions, expected)
            np.testing.assert_allclose(spec.owner_actions(found.actions), one.actions, atol=1e-6)
            image, seen = found.observation.images["eye"], one.seen[which][:known]
            near = name in LOSSY and which == "front"  # Minari leaves images of few pixels as they are
            assert np.abs(image.astype(int) - seen).max() <= (0 if not near else 60)
            assert np.abs(image.astype(int) - seen).mean() <= (0 if not near else 12)


SEVERAL = pytest.mark.parametrize("name", ["robomimic.hdf5", "minari_arrow", "lerobot_v2_1", "lerobot_v3_0"])


@SEVERAL
def test_all_cameras_come_in_each_of_its_own_size(tmp_path: Path, name: str) -> None:
    tasks = ["--task", TASKS[0]] if name == "robomimic.hdf5" else []
    bring(name, tmp_path / "x.hdf5", *tasks)
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert file.version == "1.3"
        shapes = {key.name: key.shape for key in file.spec("arm").image_keys}
        both = {camera(name, which): next(iter(episodes())).seen[which].shape[1:] for which in ("front", "wrist")}
        assert shapes == both
        assert len({*shapes.values()}) == 2
        for number, one in enumerate(episodes()):
            found = find(file, one, number).observation.images
            for which in ("front", "wrist"):
                mine, theirs = found[camera(name, which)].astype(int), one.seen[which]
                assert np.abs(mine - theirs[: len(mine)]).mean() <= (12 if name in LOSSY and which == "front" else 0)


@SEVERAL
def test_cameras_are_chosen_in_the_order_in_which_they_are_named(tmp_path: Path, name: str) -> None:
    form, *given = CASES[name]
    words = ["data", "import", form, GOLDEN / name, "--out", tmp_path / "x.hdf5", *given]
    front, wrist = camera(name, "front"), camera(name, "wrist")
    told = plp(*words, "--domain", "eye", "--image", front).out
    assert f"left out: {wrist} (a camera that was not asked for)" in told
    sizes = ["--resize", f"{wrist}=6x8"]
    assert plp(*words, "--domain", "both", "--image", wrist, "--image", front, *sizes).code == 0
    assert plp(*words, "--domain", "blind", "--without_images").code == 0
    assert plp(*words[:4], "--out", tmp_path / "y.hdf5", *LIMITS, "--fps", HZ, *DARK, "--domain", "eye").code == 0
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert [key.name for key in file.spec("both").image_keys] == [wrist, front]
        assert file.images("both", [0], wrist).shape[1:] == (6, 8, 3)
        np.testing.assert_array_equal(file.images("both", camera=front), file.images("eye"))
    with TrajectoryFile.open(tmp_path / "y.hdf5") as file:
        assert [key.kind for key in file.spec("eye").observation] == ["image", "image"]
        assert file.trajectory("eye", 0).observation.state.shape[1:] == (0,)


def test_images_are_resized_as_they_come_in(tmp_path: Path) -> None:
    bring("lerobot_v3_0", tmp_path / "x.hdf5", "--image", camera("lerobot", "front"), "--resize", "16", "20")
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        found = file.images("arm", [0])
    assert found.shape[1:] == (16, 20, 3)
    first = next(iter(episodes())).seen["front"]
    smooth = first[: len(found)].reshape(len(found), 16, 2, 20, 2, 3).mean(axis=(2, 4))
    assert np.median(np.abs(found - smooth)) < 3


def test_masks_choose_demonstrations(tmp_path: Path) -> None:
    told = bring("robomimic.hdf5", tmp_path / "x.hdf5", "--without_images", "--mask", "lift_the_lid", "--task", "lift")
    assert "2 demonstrations of 1 tasks imported" in told


def test_an_info_can_name_the_task_and_a_map_its_name(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text('{"0": "push", "1": null}')
    options = ["--task_key", "infos.goal", "--task_map", tmp_path / "map.json", "--without_images"]
    told = bring("minari_arrow", tmp_path / "x.hdf5", *options)
    assert "2 demonstrations of 1 tasks imported" in told
    assert "task left out by --task_map (2 demonstrations)" in told


def test_where_demonstrations_come_from_is_recorded(tmp_path: Path) -> None:
    bring("lerobot_v2_1", tmp_path / "x.hdf5", "--without_images")
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        record = file.provenance
    assert record["imported"] == 4
    assert record["source"][0]["folder"] == "lerobot_v2_1"
    assert record["source"][0]["files"] == 8
    assert record["action_limits"] == "by the options"
    assert {"command", "versions", "warnings", "dropped", "format"} <= record.keys()


def test_an_observation_that_is_one_array_comes_in(tmp_path: Path) -> None:
    words = ["--domain", "arm", "--fps", HZ, "--out", tmp_path / "x.hdf5"]
    answer = plp("data", "import", "minari", GOLDEN / "minari_parquet", *words)
    assert answer.code == 0, answer
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert [key.name for key in file.spec("arm").observation] == ["observation"]
        for number, one in enumerate(episodes()):
            np.testing.assert_array_equal(find(file, one, number).observation.state, one.seen["ee_pos"])
