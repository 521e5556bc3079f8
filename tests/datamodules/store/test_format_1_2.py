"""Limits of actions and sentences as tasks: files that have them are of format 1.2, all others stay as they were."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from datamodules.errors import TrajectoryFileError, UserError
from datamodules.limits import from_owner
from datamodules.store.guard import as_name
from datamodules.store.schema import is_task
from datamodules.store.writer import TrajectoryFile, add_trajectories, write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory

ARM = DomainSpec("arm", (ObservationKey("q", (2,)),), 2, 10.0)
LIMITED = DomainSpec("arm", ARM.observation, 2, 10.0, "", (-2.0, 0.1), (4.0, 0.3))
SENTENCES = ("lift", "Hebe den Deckel, bitte! 🙂", "x" * 500)


def one(task: str = "lift", seed: int = 0) -> Trajectory:
    return Trajectory("arm", task, Observation(np.full((2, 2), seed, np.float32)), np.zeros((1, 2)), seed, True)


def test_files_that_need_no_more_stay_as_old_as_they_were(tmp_path: Path) -> None:
    write_trajectories(tmp_path / "x.hdf5", [ARM], ["lift"], [one()], {})
    with h5py.File(tmp_path / "x.hdf5") as file:
        assert file.attrs["format_version"] == "1.1"
        assert file["tasks/name"].dtype == "S64"
        assert "action_low" not in file["domains/arm"].attrs
    assert "action_low" not in ARM.to_dict()
    assert DomainSpec.from_dict(ARM.to_dict()) == ARM


def test_limits_and_sentences_are_kept(tmp_path: Path) -> None:
    write_trajectories(tmp_path / "x.hdf5", [LIMITED], SENTENCES, map(one, SENTENCES), {})
    with TrajectoryFile.open(tmp_path / "x.hdf5") as file:
        assert file.version == "1.2"
        assert file.tasks == SENTENCES
        assert file.domains == (LIMITED,)
        assert [*file.episodes("arm").task] == [*SENTENCES]
    assert DomainSpec.from_dict(LIMITED.to_dict()) == LIMITED


def test_a_file_grows_into_sentences(tmp_path: Path) -> None:
    path = tmp_path / "x.hdf5"
    write_trajectories(path, [ARM], ["lift"], [one()], {})
    add_trajectories(path, [ARM], ["put it down"], [one("put it down")], {})
    with TrajectoryFile.open(path) as file:
        assert (file.version, file.tasks) == ("1.2", ("lift", "put it down"))


@pytest.mark.parametrize(("first", "second"), [(ARM, LIMITED), (LIMITED, ARM)])
def test_a_domain_keeps_its_limits(tmp_path: Path, first: DomainSpec, second: DomainSpec) -> None:
    write_trajectories(tmp_path / "x.hdf5", [first], ["lift"], [one()], {})
    with pytest.raises(TrajectoryFileError, match="domain 'arm' has action_low"):
        add_trajectories(tmp_path / "x.hdf5", [second], ["lift"], [one(seed=1)], {})


@pytest.mark.parametrize(
    ("low", "high"),
    [((-1,), (1, 1)), ((-1, -1), None), ((0, 1), (1, 1)), ((-np.inf, 0), (1, 1)), ((np.nan, 0), (1, 1)), ((), ())],
)
def test_limits_that_limit_nothing_are_refused(low, high) -> None:
    with pytest.raises(UserError, match="domain 'arm' has action limits"):
        DomainSpec("arm", ARM.observation, 2, 10.0, "", low, high)


def test_limits_are_undone() -> None:
    raw = np.random.default_rng(0).uniform(*LIMITED.action_limits, size=(1000, 2))
    scaled = from_owner(raw, LIMITED.action_limits)
    assert scaled.dtype == np.float32
    assert np.abs(scaled).max() <= 1
    np.testing.assert_allclose(LIMITED.owner_actions(scaled), raw, atol=1e-6)
    np.testing.assert_array_equal(from_owner(LIMITED.owner_actions(scaled), LIMITED.action_limits), scaled)
    np.testing.assert_array_equal(
        from_owner(np.array(LIMITED.action_limits), LIMITED.action_limits), [[-1, -1], [1, 1]]
    )
    assert ARM.owner_actions(scaled) is scaled


@pytest.mark.parametrize("task", ["", " lift", "lift\n", "a\tb", "..", ".", "x" * 501, "\x1b[2J", "é" * 251])
def test_texts_that_are_no_task(task: str) -> None:
    assert not is_task(task)


@pytest.mark.parametrize("task", ["../../etc", "/", "..", "a/b", "Hebe den Deckel!", "x" * 500, "CON:", "...", "é"])
def test_folders_of_sentences_are_safe_and_different(task: str) -> None:
    name = as_name(task)
    assert Path("runs", name).resolve().parent == Path("runs").resolve()
    assert name.isascii()
    assert len(name) <= 64
    assert name != as_name(task + "!")


def test_folders_of_names_are_the_names() -> None:
    assert [as_name(task) for task in ("goal_1_6", "x2y2h2", "a.b-c")] == ["goal_1_6", "x2y2h2", "a.b-c"]
