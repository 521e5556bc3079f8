from __future__ import annotations

import h5py
import maze2d
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datamodules.errors import TrajectoryFileError
from datamodules.formats import describe_source
from datamodules.formats.maze2d import Walk, read_walk, split_walk


def walk_of(
    goals: list[int], timeouts: list[int], repeats: tuple[int, ...] = (), places: np.ndarray | None = None
) -> Walk:
    """Goal k is at (k, k); state n is (n, n, n, n), but for the rows that repeat the one before."""
    steps = len(goals)
    states = np.repeat(np.arange(steps, dtype=np.float32)[:, None], 4, axis=1)
    for row in repeats:
        states[row] = states[row - 1]
    flags = np.isin(np.arange(steps), timeouts)
    goal = np.repeat(np.array(goals, np.float32)[:, None], 2, axis=1)
    return Walk(states, -states[:, :2], goal, flags, states if places is None else places)


def spans(walk: Walk) -> list[tuple[int, int, float]]:
    return [(piece.row, piece.row + len(piece.actions), float(piece.goal[0])) for piece in split_walk(walk)]


def test_a_walk_is_cut_after_timeouts_and_where_the_goal_changes():
    goals = [7, 7, 7, 7, 5, 5, 5, 7, 7]
    assert spans(walk_of(goals, [])) == [(0, 4, 7), (4, 7, 5), (7, 9, 7)]
    # The same goal was drawn twice in a row; and the walk ends on a timeout.
    assert spans(walk_of(goals, [1, 3, 8])) == [(0, 2, 7), (2, 4, 7), (4, 7, 5), (7, 9, 7)]


def test_first_step_that_repeats_the_last_one_is_left_out():
    pieces = split_walk(walk_of([1, 1, 1, 2, 2, 2, 3], [2, 5], repeats=(2, 3, 6)))
    # Row 2 stands still in mid-walk and stays; row 3 repeats over the cut; the last piece is nothing but a repeat.
    assert [(p.row, len(p.actions)) for p in pieces] == [(0, 3), (4, 2), (7, 0)]
    np.testing.assert_array_equal(pieces[1].states[:, 0], [4, 5])
    np.testing.assert_array_equal(pieces[1].actions[:, 0], [-4, -5])


def last_states(walk: Walk) -> list[float | None]:
    """What was seen after the last action of each piece, where that is known."""
    return [float(p.states[-1, 0]) if len(p.states) > len(p.actions) else None for p in split_walk(walk)]


def test_what_was_seen_last_is_what_the_next_way_begins_with_unless_that_is_the_old_observation_again():
    goals = [1, 1, 1, 2, 2, 2, 3]
    assert last_states(walk_of(goals, [2, 5])) == [3, 6, None]
    # Row 4 is two actions after row 2, so where the action of row 2 led was never seen.
    assert last_states(walk_of(goals, [2, 5], repeats=(3,))) == [None, 6, None]


def test_the_simulators_own_record_tells_where_the_last_action_led():
    places = 10.0 + np.repeat(np.arange(7, dtype=np.float32)[:, None], 4, axis=1)
    walk = walk_of([1, 1, 1, 2, 2, 2, 3], [2, 5], repeats=(3,), places=places)
    assert last_states(walk) == [13, 16, None]
    np.testing.assert_array_equal(split_walk(walk)[0].states[:, 0], [0, 1, 2, 13])
    np.testing.assert_array_equal(split_walk(walk)[1].states[:, 0], [4, 5, 16])


@given(st.lists(st.tuples(st.integers(0, 2), st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_pieces_are_those_of_a_walk_followed_step_by_step(rows):
    goals, flags = [goal for goal, _, _ in rows], [i for i, (_, flag, _) in enumerate(rows) if flag]
    walk = walk_of(goals, flags, tuple(i for i, (_, _, repeat) in enumerate(rows) if repeat and i > 0))
    expected: list[list[int]] = [[]]
    for row in range(len(rows)):
        fresh = row > 0 and (row - 1 in flags or goals[row] != goals[row - 1])
        if fresh:
            expected.append([])
        if not (fresh and walk.states[row, 0] == walk.states[row - 1, 0]):
            expected[-1].append(row)
    assert [list(range(a, b)) for a, b, _ in spans(walk)] == expected


def test_a_file_with_all_fields_is_read(tmp_path):
    arrays = maze2d.walk([0, 3, 1])
    walk = read_walk(maze2d.write(tmp_path / "x.hdf5", arrays))
    for ours, theirs in (("states", "observations"), ("actions", "actions"), ("goals", "infos/goal")):
        np.testing.assert_array_equal(getattr(walk, ours), arrays[theirs])
        assert getattr(walk, ours).dtype == np.float32
    assert np.flatnonzero(walk.timeouts).tolist() == [37, 37 + 26]  # 3 m and 2 m, 8 cm a step
    first, second = split_walk(walk)
    assert (first.row, len(first.actions), second.row, len(second.actions)) == (0, 38, 39, 25)


def test_a_file_without_timeouts_is_cut_at_the_same_steps(tmp_path):
    arrays = maze2d.walk([0, 3, 1, 6])
    marked = spans(read_walk(maze2d.write(tmp_path / "x.hdf5", arrays)))
    del arrays["timeouts"]
    assert spans(read_walk(maze2d.write(tmp_path / "y.hdf5", arrays))) == marked


def test_double_precision_is_read_as_ours(tmp_path):
    arrays = maze2d.walk([0, 3])
    arrays["observations"] = arrays["observations"].astype(np.float64)
    assert read_walk(maze2d.write(tmp_path / "x.hdf5", arrays)).states.dtype == np.float32


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("observations", None, "found no array observations; expected D4RL's maze2d arrays"),
        ("infos/goal", None, "found no array infos/goal"),
        (
            "observations",
            np.zeros((38, 29)),
            r"observations of shape \(38, 29\), type float64; expected shape \(38, 4\)",
        ),
        ("actions", np.zeros((37, 2)), r"observations of shape \(38, 4\), type float32; expected shape \(37, 4\)"),
        ("actions", np.zeros((38, 2), int), "actions of shape .*, type int64; expected .* floating-point numbers"),
        ("timeouts", np.zeros(38), "timeouts of shape .*, type float64; expected .* true or false"),
        ("infos/goal", np.full((38, 2), np.nan), "a value that is not finite in infos/goal, step 0"),
        ("actions", np.zeros((0, 2)), "found 0 steps in actions; expected 1 to"),
        ("actions", np.float32(0), "found 0 steps in actions"),
        ("observations", np.full((38, 4), b"x"), r"observations of shape \(38, 4\), type \|S1"),
    ],
)
def test_what_is_no_maze2d_file_is_refused(tmp_path, name, array, message):
    arrays = maze2d.walk([0, 3])
    del arrays[name]
    path = tmp_path / "x.hdf5"
    with h5py.File(maze2d.write(path, arrays), "a") as file:
        if array is not None:
            file[name] = array
    with pytest.raises(TrajectoryFileError, match=message):
        read_walk(path)


def test_a_group_in_an_arrays_place_is_refused(tmp_path):
    arrays = maze2d.walk([0, 3])
    arrays["timeouts/deep"] = arrays.pop("timeouts")
    with pytest.raises(TrajectoryFileError, match="no array timeouts"):
        read_walk(maze2d.write(tmp_path / "x.hdf5", arrays))


def test_hostile_files_are_refused(tmp_path):
    path = maze2d.write(tmp_path / "x.hdf5", maze2d.walk([0, 3]))
    with h5py.File(path, "a") as file:
        del file["observations"]
        file["observations"] = h5py.ExternalLink("/etc/passwd", "/x")
    with pytest.raises(TrajectoryFileError, match="soft or external link"):
        read_walk(path)
    with h5py.File(path, "a") as file:
        del file["observations"]
        file.create_dataset("observations", (38, 4), "f4", maxshape=(None, 4), chunks=(2**25, 4))
    with pytest.raises(TrajectoryFileError, match="observations in blocks of 512 MiB; expected at most 256 MiB"):
        read_walk(path)
    with h5py.File(path, "a") as file:
        del file["actions"]
        file.create_dataset("actions", (20_000_000, 2), "f4", chunks=(1000, 2))
    with pytest.raises(TrajectoryFileError, match="20000000 steps in actions; expected 1 to 10000000"):
        read_walk(path)


def test_a_damaged_or_missing_file_is_one_line(tmp_path):
    path = maze2d.write(tmp_path / "x.hdf5", maze2d.walk([0, 3]))
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(TrajectoryFileError, match="cannot be read as HDF5"):
        read_walk(path)
    with pytest.raises(TrajectoryFileError, match="no such file"):
        read_walk(tmp_path / "none.hdf5")


def test_source_is_described_by_what_is_in_it(tmp_path):
    (tmp_path / "x").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1
    sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert describe_source(tmp_path / "x") == {"file": "x", "bytes": 3, "sha256": sha256}
