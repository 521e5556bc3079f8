from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from demonstrations import ARM, CAMERA, SPECS, TASKS, WHY, assert_equal, demonstration, demonstrations
from hypothesis import given, settings
from hypothesis import strategies as st

from datamodules.errors import TrajectoryFileError, UserError
from datamodules.store.writer import TrajectoryFile, add_trajectories, write_trajectories
from datamodules.types import DomainSpec, Observation, ObservationKey, Trajectory


@st.composite
def experiments(draw):
    specs = []
    for name in draw(st.lists(st.sampled_from(["a", "b.2", "C-3", "_d"]), min_size=1, max_size=3, unique=True)):
        sizes = draw(st.lists(st.integers(1, 4), min_size=1, max_size=3))
        keys = [ObservationKey(f"k{i}", (size,), unit="m") for i, size in enumerate(sizes)]
        if draw(st.booleans()):
            keys.insert(
                draw(st.integers(0, len(keys))), ObservationKey("cam", (2, 3, draw(st.integers(1, 3))), "image")
            )
        specs.append(DomainSpec(name, tuple(keys), draw(st.integers(1, 3)), draw(st.integers(1, 50))))
    keys = st.tuples(
        *(st.sampled_from(specs), st.sampled_from(TASKS), st.integers(0, 2**40), st.integers(1, 20), st.booleans())
    )
    chosen = draw(st.lists(keys, max_size=8, unique_by=lambda key: (key[0].name, *key[1:3])))
    return specs, [demonstration(*key) for key in chosen]


def everything(path: Path) -> list[Trajectory]:
    with TrajectoryFile.open(path) as file:
        return [file.trajectory(s.name, e) for s in file.domains for e in range(len(file.episodes(s.name).task))]


def same_key(one: Trajectory, other: Trajectory) -> bool:
    return (one.domain, one.task, one.seed) == (other.domain, other.task, other.seed)


# -- what is written is read ---------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(experiments(), st.booleans())
def test_round_trip(tmp_path_factory, experiment, compress):
    specs, given_trajectories = experiment
    path = tmp_path_factory.mktemp("round") / "x.hdf5"
    write_trajectories(path, specs, TASKS, iter(given_trajectories), WHY, compress=compress)
    with TrajectoryFile.open(path) as file:
        assert file.domains == tuple(specs)
        assert file.tasks == TASKS
        assert file.provenance == WHY
    found = everything(path)
    assert len(found) == len(given_trajectories)
    for trajectory in given_trajectories:
        assert_equal(next(t for t in found if same_key(t, trajectory)), trajectory)


def test_episodes_are_sorted_by_task_then_seed(tmp_path):
    given_order = [("lift", 1), ("reach", 7), ("push", 0), ("reach", 2), ("lift", 0)]
    write_trajectories(tmp_path / "x", [ARM], TASKS, [demonstration(ARM, t, s) for t, s in given_order], WHY)
    with TrajectoryFile.open(tmp_path / "x") as file:
        table = file.episodes("arm")
    assert list(table.task) == ["reach", "reach", "push", "lift", "lift"]
    assert list(table.seed) == [2, 7, 0, 0, 1]
    assert list(table.success) == [False, True, False, False, True]
    assert list(table.offset) == [0, 5, 10, 15, 20, 25]


def test_demonstrations_with_the_same_seed_keep_their_order(tmp_path):
    given_order = [demonstration(ARM, "push", 1, steps) for steps in (6, 2, 4)]
    write_trajectories(tmp_path / "x", [ARM], TASKS, given_order, WHY)
    assert [len(t) for t in everything(tmp_path / "x")] == [6, 2, 4]


def test_counts_hold_zeros(tmp_path):
    write_trajectories(tmp_path / "x", SPECS, TASKS, [demonstration(ARM, "push", s) for s in range(3)], WHY)
    with TrajectoryFile.open(tmp_path / "x") as file:
        assert file.counts() == {"arm": {"reach": 0, "push": 3, "lift": 0}, "camera": dict.fromkeys(TASKS, 0)}
        empty = file.read("camera")
        assert empty.state.shape == (0, 2)
        assert empty.images["image"].shape == (0, 4, 5, 3)
        assert list(empty.offset) == [0]


@settings(max_examples=30, deadline=None)
@given(chosen=st.lists(st.integers(0, 8), max_size=12))
def test_read_lays_chosen_episodes_end_to_end(tmp_path_factory, chosen):
    path = tmp_path_factory.getbasetemp() / "chosen.hdf5"
    if not path.exists():
        write_trajectories(path, SPECS, TASKS, demonstrations(3), WHY)
    with TrajectoryFile.open(path) as file:
        arrays = file.read("camera", np.array(chosen, np.int64))
        single = [file.trajectory("camera", e) for e in chosen]
    assert list(arrays.task) == [t.task for t in single]
    assert list(arrays.offset) == [0, *np.cumsum([len(t) for t in single])]
    for number, trajectory in enumerate(single):
        steps = slice(arrays.offset[number], arrays.offset[number + 1])
        seen = [*range(steps.start, steps.stop), *([arrays.last[number]] if trajectory.last_known else [])]
        np.testing.assert_array_equal(arrays.state[seen], trajectory.observation.state)
        np.testing.assert_array_equal(arrays.images["image"][seen], trajectory.observation.images["image"])
        np.testing.assert_array_equal(arrays.actions[steps], trajectory.actions)
    assert [last >= 0 for last in arrays.last] == [t.last_known for t in single]
    assert len(arrays.actions) == arrays.offset[-1]
    assert len(arrays.state) == len(arrays.images["image"]) == arrays.offset[-1] + sum(t.last_known for t in single)


def test_state_holds_the_keys_in_the_order_of_the_spec(path):
    wanted = demonstration(ARM, "reach", 0, 4).observation.state
    with h5py.File(path) as raw:
        np.testing.assert_array_equal(raw["domains/arm/obs/pos"][:4], wanted[:, :3])
        np.testing.assert_array_equal(raw["domains/arm/obs/grip"][:4], wanted[:, 3:])
        assert dict(raw["domains/arm/obs/pos"].attrs)["unit"] == "m"


def test_images_can_be_left_out(path):
    with TrajectoryFile.open(path) as file:
        assert file.read("camera", images=False).images == {}
        assert file.read("arm").images == {}


def test_storage_of_vectors_and_images(path, tmp_path):
    write_trajectories(tmp_path / "small", SPECS, TASKS, demonstrations(), WHY, compress=True)
    with h5py.File(path) as raw, h5py.File(tmp_path / "small") as small:
        assert raw["domains/camera/obs/image"].chunks == (8, 4, 5, 3)
        assert raw["domains/camera/obs/image"].compression == "gzip"
        assert raw["domains/arm/actions"].chunks is None
        assert small["domains/arm/actions"].compression == "gzip"
    add_trajectories(tmp_path / "small", SPECS, TASKS, [demonstration(ARM, "lift", 9)], WHY)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: f.read("leg"), r"no domain 'leg'; it has: arm, camera"),
        (lambda f: f.episodes("leg"), r"no domain 'leg'"),
        (lambda f: f.read("arm", [6]), r"domain 'arm' has episodes 0 to 5; asked for 6"),
        (lambda f: f.trajectory("arm", -1), r"asked for -1"),
    ],
)
def test_wrong_questions(path, call, message):
    with TrajectoryFile.open(path) as file, pytest.raises(UserError, match=message):
        call(file)


# -- growth --------------------------------------------------------------------------------------------


@settings(max_examples=12, deadline=None)
@given(st.randoms(use_true_random=False), st.integers(1, 4))
def test_content_does_not_depend_on_the_order_of_collection(tmp_path_factory, random, parts):
    folder = tmp_path_factory.mktemp("grow")
    write_trajectories(folder / "once", SPECS, TASKS, demonstrations(), WHY)
    shuffled = random.sample(demonstrations(), 12)
    for part in range(parts):
        add_trajectories(folder / "grown", SPECS, TASKS, shuffled[part::parts], WHY)
    assert (folder / "grown").read_bytes() == (folder / "once").read_bytes()


def test_a_demonstration_is_added_once(path):
    before = path.read_bytes()
    add_trajectories(path, SPECS, TASKS, demonstrations(), WHY)
    assert path.read_bytes() == before


def test_new_domains_and_tasks_follow_the_old(tmp_path):
    add_trajectories(tmp_path / "x", [CAMERA], ["lift"], [demonstration(CAMERA, "lift", 1)], WHY)
    add_trajectories(tmp_path / "x", [ARM], ["push"], [demonstration(ARM, "push", 1)], {"command": "again"})
    with TrajectoryFile.open(tmp_path / "x") as file:
        assert [spec.name for spec in file.domains] == ["camera", "arm"]
        assert file.tasks == ("lift", "push")
        assert file.provenance == {"command": "again", "earlier": [WHY]}
    add_trajectories(tmp_path / "x", SPECS, TASKS, [], WHY)
    with TrajectoryFile.open(tmp_path / "x") as file:
        assert file.domains == SPECS
        assert file.tasks == TASKS
        assert_equal(file.trajectory("camera", 0), demonstration(CAMERA, "lift", 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"control_hz": 50.0}, r"domain 'arm' has control_hz 20.0 in the file; expected 50.0"),
        ({"action_size": 3}, r"action_size 4 in the file; expected 3"),
        ({"env": "other"}, r"env 'an arm' in the file; expected 'other'"),
        ({"observation": ARM.observation[:1]}, r"keys pos, grip in the file; expected pos"),
        (
            {"observation": (replace(ARM.observation[0], unit="cm"), ARM.observation[1])},
            r"key 'pos' with unit 'm' in the file; expected 'cm'",
        ),
    ],
)
def test_growth_with_another_domain_of_the_same_name_is_refused(path, change, message):
    before = path.read_bytes()
    with pytest.raises(TrajectoryFileError, match=message):
        add_trajectories(path, [replace(ARM, **change)], TASKS, [], WHY)
    assert path.read_bytes() == before


def test_growth_does_not_drop_what_others_added(path):
    with h5py.File(path, "a") as file:
        file["domains/arm/rewards"] = np.zeros(3)
    with pytest.raises(TrajectoryFileError, match=r"/domains/arm/rewards; growing would drop it"):
        add_trajectories(path, SPECS, TASKS, [], WHY)


def test_writing_does_not_replace_a_file(path):
    with pytest.raises(TrajectoryFileError, match=r"the file exists; expected a new one"):
        write_trajectories(path, SPECS, TASKS, [], WHY)


# -- what is refused at the door -------------------------------------------------------------------------


def changed(state=None, actions=None, image=None) -> Trajectory:
    old = demonstration(CAMERA, "push", 11)
    observation = Observation(
        old.observation.state if state is None else state,
        old.observation.images if image is None else {"image": image},
    )
    return replace(old, observation=observation, actions=old.actions if actions is None else actions)


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (changed(state=np.array([[0, 1]] * 4 + [[0, np.nan]])), r"not finite in 'joints', step 4"),
        (changed(np.array([[0, 1]] * 5 + [[0, np.inf]]), image=np.zeros((6, 4, 5, 3), np.uint8)), r"'joints', step 5"),
        (changed(state=np.zeros((6, 2))), r"images \(\(5, 4, 5, 3\).*; expected \(\(6, 4, 5, 3\)"),
        (changed(state=np.full((5, 2), 1e300)), r"not finite in 'joints', step 0"),
        (changed(state=np.zeros((5, 3))), r"state of shape \(5, 3\); expected \(5, 2\)"),
        (
            changed(actions=np.full((5, 2), np.inf)),
            r"actions \[inf, inf\] in step 0; expected finite values in \[-1, 1\]",
        ),
        (changed(actions=np.full((5, 2), np.nan)), r"actions \[nan, nan\] in step 0"),
        (changed(actions=np.array([[0, 0]] * 3 + [[0, -1.5]] * 2)), r"actions \[0.0, -1.5\] in step 3"),
        (changed(actions=np.zeros((5, 1))), r"actions of shape \(5, 1\); expected \(5, 2\)"),
        (changed(image=np.zeros((5, 4, 5, 3))), r"images .*float64.*; expected .*uint8"),
        (changed(image=np.zeros((5, 3, 4, 5), np.uint8)), r"images \(\(5, 3, 4, 5\).*; expected \(\(5, 4, 5, 3\)"),
        (replace(changed(), task="fly"), r"unknown task; expected one of reach, push, lift"),
        (replace(changed(), domain="leg"), r"unknown domain; expected one of arm, camera"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_demonstrations_that_do_not_fit_are_refused(tmp_path, trajectory, message):
    where = rf"task '{trajectory.task}' in domain '{trajectory.domain}', seed 11: found .*"
    with pytest.raises(TrajectoryFileError, match=where + message) as caught:
        write_trajectories(tmp_path / "x", SPECS, TASKS, [demonstration(CAMERA, "push", 1), trajectory], WHY)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("specs", "tasks", "message"),
    [
        ([replace(ARM, name="../arm")], TASKS, r"name '../arm'; expected 1 to 64 letters"),
        ([replace(ARM, observation=(ObservationKey("a b", (1,)),))], TASKS, r"name 'a b'"),
        (
            [replace(ARM, observation=(ObservationKey("a", (1, 2)),))],
            TASKS,
            r"shape \(1, 2\); expected \(n,\) for state",
        ),
        ([replace(ARM, observation=ARM.observation * 2)], TASKS, r"keys pos, grip, pos, grip; expected different"),
        ([replace(ARM, action_size=0)], TASKS, r"0 actions at 20.0 Hz"),
        ([replace(ARM, control_hz=float("nan"))], TASKS, r"4 actions at nan Hz"),
        ([replace(ARM, env="\x1b[2J")], TASKS, r"control characters in env or unit"),
        ([ARM, ARM], TASKS, r"domains arm, arm; expected every name once"),
        ([ARM], ["lift", "lift"], r"tasks lift, lift; expected every name once"),
        ([ARM], [".."], r"task name '\.\.'"),
    ],
)
def test_names_and_shapes_are_checked_before_writing(tmp_path, specs, tasks, message):
    with pytest.raises(TrajectoryFileError, match=message):
        write_trajectories(tmp_path / "x", specs, tasks, [], WHY)


def test_provenance_must_fit_json(tmp_path):
    with pytest.raises(TrajectoryFileError, match=r"provenance cannot be stored"):
        write_trajectories(tmp_path / "x", [ARM], TASKS, [], {"when": object()})
