"""Last observations in files: where they stand, how they are read, how they join demonstrations that lacked them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from demonstrations import ARM, CAMERA, SPECS, TASKS, WHY, assert_equal, demonstration

from datamodules.store.writer import TrajectoryFile, add_trajectories, write_trajectories
from datamodules.types import Observation, Trajectory


def everything(path: Path) -> list[Trajectory]:
    with TrajectoryFile.open(path) as file:
        return [file.trajectory(s.name, e) for s in file.domains for e in range(len(file.episodes(s.name).task))]


def test_what_was_seen_last_stands_behind_the_steps(path):
    known, unknown = demonstration(ARM, "push", 1, 5, last=True), demonstration(ARM, "push", 0, 4)
    with h5py.File(path) as raw:
        arm = raw["domains/arm"]
        assert raw.attrs["format_version"] == "1.1"
        assert arm["episodes/last"][()].tolist() == [-1, 27, -1, 28, -1, 29]
        assert (len(arm["actions"]), len(arm["obs/pos"]), len(raw["domains/camera/obs/image"])) == (27, 30, 30)
        start, last = arm["episodes/offset"][3], arm["episodes/last"][3]
        np.testing.assert_array_equal(arm["obs/pos"][[*range(start, start + 5), last]], known.observation.state[:, :3])
    with TrajectoryFile.open(path) as file:
        assert (file.trajectory("arm", 3).last_known, file.trajectory("arm", 2).last_known) == (True, False)
        assert_equal(file.trajectory("arm", 3), known)
        assert_equal(file.trajectory("arm", 2), unknown)


def test_one_demonstration_is_read_without_what_lies_between_it_and_its_last_observation(tmp_path, monkeypatch):
    made = [demonstration(ARM, "push", seed, 50, last=True) for seed in range(40)]
    write_trajectories(tmp_path / "x", [ARM], TASKS, made, WHY)
    read: list[int] = []
    original = h5py.Dataset.read_direct

    def counted(self, out, source, target):
        read.append(len(out[target]))
        original(self, out, source, target)

    monkeypatch.setattr(h5py.Dataset, "read_direct", counted)
    with TrajectoryFile.open(tmp_path / "x") as file:
        assert_equal(file.trajectory("arm", 1), made[1])
    assert read == [50, 1, 50, 1]  # two keys


def test_a_last_observation_that_the_file_lacked_is_added_to_its_demonstration(tmp_path):
    known = [demonstration(spec, "push", 1, last=True) for spec in SPECS]
    cut = [replace(t, observation=t.observation.take(slice(len(t)))) for t in known]
    add_trajectories(tmp_path / "x", SPECS, TASKS, cut, WHY)
    add_trajectories(tmp_path / "x", SPECS, TASKS, known, WHY)
    grown = everything(tmp_path / "x")
    assert len(grown) == len(known)
    for one, other in zip(grown, known, strict=True):
        assert_equal(one, other)
    before = (tmp_path / "x").read_bytes()
    add_trajectories(tmp_path / "x", SPECS, TASKS, cut, WHY)
    assert (tmp_path / "x").read_bytes() == before


def test_demonstrations_that_end_differently_are_two(tmp_path):
    one = demonstration(CAMERA, "push", 1, last=True)
    image = one.observation.images["image"].copy()
    image[-1] ^= 1
    other = replace(one, observation=Observation(one.observation.state, {"image": image}))
    add_trajectories(tmp_path / "x", SPECS, TASKS, [one], WHY)
    add_trajectories(tmp_path / "x", SPECS, TASKS, [other], WHY)
    assert len(everything(tmp_path / "x")) == 2
