"""Files of format 1.0, which never say what was seen last, stay readable and may grow."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import seen
import torch
from demonstrations import assert_equal

from datamodules.store.validation import validate_file
from datamodules.store.writer import TrajectoryFile, add_trajectories, verify_hashes
from datamodules.types import Trajectory
from plp_lightning.cli.data import inspect_file

FINGERPRINT = "11f876650c2c6be294bbfadbb9940fe03298bb67dddeaa14c296ce0ed7a2cb77"
"""Of the data that a run reads from the file, as the code that wrote it computed it."""


def everything(path: Path) -> list[Trajectory]:
    with TrajectoryFile.open(path) as file:
        return [file.trajectory(s.name, e) for s in file.domains for e in range(len(file.episodes(s.name).task))]


def with_an_end(trajectory: Trajectory) -> Trajectory:
    """The demonstration and, as what was seen last, its first observation once more."""
    rows = [*range(len(trajectory)), 0]
    return replace(trajectory, observation=trajectory.observation.take(rows))


@pytest.fixture
def old(format_1_0: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(format_1_0, tmp_path / "old.hdf5"))


def grow(path: Path, trajectories: list[Trajectory]) -> None:
    specs = [domain.simulator.spec(name) for name, domain in seen.domains().items()]
    add_trajectories(path, specs, seen.TASKS, trajectories, {"command": "tests"})


def test_it_is_read(format_1_0: Path) -> None:
    verify_hashes(format_1_0)
    with TrajectoryFile.open(format_1_0) as file:
        assert file.version == "1.0"
        assert file.counts() == {name: dict.fromkeys(seen.TASKS, 4) for name in ("left", "right")}
        assert file.episodes("left").last.tolist() == [-1] * 12
        assert len(file.read("left").state) == len(file.images("left")) == file.episodes("left").offset[-1]
    found = everything(format_1_0)
    assert not any(trajectory.last_known for trajectory in found)
    with h5py.File(format_1_0) as raw:
        for domain in ("left", "right"):
            group, mine = raw[f"domains/{domain}"], [t for t in found if t.domain == domain]
            for name, parts in {
                "obs/position": [t.observation.state for t in mine],
                "obs/camera": [t.observation.images["camera"] for t in mine],
                "actions": [t.actions for t in mine],
            }.items():
                np.testing.assert_array_equal(group[name][()], np.concatenate(parts))  # type: ignore[arg-type]
            assert group["episodes/seed"][()].tolist() == [t.seed for t in mine]


def test_it_is_shown_and_checked(format_1_0: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inspect_file(str(format_1_0), json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["format"] == "plp-trajectories 1.0"
    assert [domain["last_known"] for domain in found["domains"]] == [0, 0]
    findings = validate_file(format_1_0)
    assert {finding.severity for finding in findings} == {"info"}
    assert sum("4 of 4 demonstrations end without a last obs" in finding.message for finding in findings) == 6


def test_runs_that_began_with_it_go_on(format_1_0: Path) -> None:
    data = seen.data_module(format_1_0, trajectories=8)
    assert data.fingerprint == FINGERPRINT
    for dataset in data.datasets.values():
        assert len(dataset.observation) == len(dataset)
        assert torch.equal(
            dataset.next_row < 0, torch.isin(torch.arange(len(dataset)), torch.tensor(dataset.offset) - 1)
        )


def test_a_file_that_grows_becomes_1_1_and_keeps_what_it_held(old: Path) -> None:
    before, more = everything(old), seen.demonstrations(5)[4::5]
    grow(old, more)
    verify_hashes(old)
    after = everything(old)
    with TrajectoryFile.open(old) as file:
        assert file.version == "1.1"
        assert file.provenance == {"command": "tests"}
    assert len(after) == len(before) + len(more)
    for trajectory in [*before, *more]:
        (found,) = [
            t for t in after if (t.domain, t.task, t.seed) == (trajectory.domain, trajectory.task, trajectory.seed)
        ]
        assert_equal(found, trajectory)
    assert sum(t.last_known for t in after) == len(more) == 6
    assert not [finding for finding in validate_file(old) if finding.severity != "info"]
    assert seen.data_module(old, trajectories=8).fingerprint == FINGERPRINT


def test_what_was_seen_last_joins_the_demonstrations_that_lacked_it(old: Path, tmp_path: Path) -> None:
    ended = [with_an_end(trajectory) for trajectory in everything(old)]
    grow(old, ended)
    grow(tmp_path / "new.hdf5", ended)
    assert all(trajectory.last_known for trajectory in everything(old))
    assert old.read_bytes() == (tmp_path / "new.hdf5").read_bytes()
    with TrajectoryFile.open(old) as file:
        np.testing.assert_array_equal(
            file.images("left", [0])[-1], file.trajectory("left", 0).observation.images["camera"][-1]
        )
