from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest
from demonstrations import ARM, CAMERA, TASKS, demonstration, demonstrations

from datamodules.store.validation import Finding, validate_file
from datamodules.store.writer import write_trajectories
from datamodules.types import Observation

SPECS = (ARM, CAMERA)
TWICE = "visit a state twice: TCC cannot tell the visits apart"


@pytest.fixture
def check(tmp_path):
    def write_and_check(trajectories, specs=SPECS):
        write_trajectories(tmp_path / "x", specs, TASKS, trajectories, {})
        return validate_file(tmp_path / "x")

    return write_and_check


def successes(seeds=(0, 1), last=True):
    made = [demonstration(spec, t, s, 4 + s, last) for spec in SPECS for t in TASKS for s in seeds]
    return [replace(trajectory, success=True) for trajectory in made]


def with_state(steps) -> list:
    state = np.array(steps, np.float32).repeat(4, axis=1) * [1, 2, 3, 4]
    one = demonstration(ARM, "push", 1, len(state))
    return [replace(one, observation=Observation(state.astype(np.float32)), success=True)]


def test_a_good_file_has_only_counts(check):
    pairs = [Finding("info", f"{s.name}, {t}", "2 demonstrations of 4 to 5 steps") for s in SPECS for t in TASKS]
    assert check(successes()) == pairs


def test_demonstrations_without_a_last_observation_are_counted(check):
    found = check([*successes((0,)), *successes((1, 2), last=False)])
    message = "2 of 3 demonstrations end without a last observation: phases that look a step ahead leave their last"
    assert sum(f.severity == "info" and f.message.startswith(message) for f in found) == len(SPECS) * len(TASKS)


def test_a_task_that_a_domain_lacks_is_named(check):
    findings = check([t for t in successes() if (t.domain, t.task) != ("camera", "push")])
    warnings = [finding for finding in findings if finding.severity == "warning"]
    assert warnings == [
        Finding("warning", "camera, push", "no demonstration here, but in arm: it cannot align the two")
    ]


def test_a_task_that_nobody_shows_is_fine(check):
    assert {f.severity for f in check([t for t in successes() if t.task != "lift"])} == {"info"}


@pytest.mark.parametrize(
    ("steps", "warned"),
    [([[0], [1], [2]], False), ([[0], [1], [0]], True), ([[0], [0], [1]], True), ([[0], [1], [1e-6]], False)],
)
def test_states_visited_twice(check, steps, warned):
    findings = check(with_state(steps), [ARM])
    assert (Finding("warning", "arm, push", f"1 of 1 demonstrations {TWICE}") in findings) is warned


def test_a_state_may_be_visited_by_two_demonstrations(check):
    one = with_state([[0], [1]])[0]
    assert not any(TWICE in f.message for f in check([one, replace(one, seed=2)], [ARM]))


def test_failures_short_ones_repeated_seeds_and_constants(check):
    failed = replace(demonstration(ARM, "push", 2, 1), success=False)
    again = replace(demonstration(ARM, "push", 2, 3), success=True)
    flat = again.observation.state.copy()
    flat[:, 1:4] = failed.observation.state[0, 1:4]
    again = replace(again, observation=Observation(flat))
    warnings = {(f.place, f.message) for f in check([failed, again], [ARM]) if f.severity == "warning"}
    assert warnings == {
        ("arm, push", "1 of 2 demonstrations did not succeed"),
        ("arm, push", "1 demonstrations are one step long: nothing to align in time"),
        ("arm, push", "1 seeds are used more than once, first 2: are these copies?"),
        ("arm, pos", "columns [1, 2] never change: they cannot be normalised by their spread"),
        ("arm, grip", "columns [0] never change: they cannot be normalised by their spread"),
    }


def tamper(path, place, row, value):
    with h5py.File(path, "a") as file:
        file[place][row] = value


@pytest.mark.parametrize(
    ("place", "row", "value", "where", "message"),
    [
        ("/domains/arm/obs/grip", 4, np.nan, "arm, grip", "1 steps are not finite, first in episode 1, step 0"),
        (
            "/domains/arm/obs/pos",
            (28, 1),
            np.inf,
            "arm, pos",
            "1 steps are not finite, first in episode 3, after its last step",
        ),
        ("/domains/arm/actions", 3, np.inf, "arm, actions", "1 steps are not finite, first in episode 0, step 3"),
        (
            "/domains/arm/actions",
            slice(25, 27),
            -1.1,
            "arm, actions",
            r"2 steps outside [-1, 1], first in episode 5, step 3",
        ),
    ],
)
def test_values_that_no_writer_stores_are_errors(tmp_path, place, row, value, where, message):
    write_trajectories(tmp_path / "x", SPECS, TASKS, demonstrations(), {})
    tamper(tmp_path / "x", place, row, value)
    findings = validate_file(tmp_path / "x")
    assert Finding("error", where, message) in findings
    assert Finding("error", place, "values do not match their hash: copy or collect the file again") in findings
    severities = [finding.severity for finding in findings]
    assert severities == sorted(severities, key=["error", "warning", "info"].index)


def test_a_file_that_does_not_open_is_one_error(tmp_path):
    (tmp_path / "x").write_text("no")
    (finding,) = validate_file(tmp_path / "x")
    assert (finding.severity, finding.place) == ("error", str(tmp_path / "x"))
    assert finding.message.startswith("cannot be read as HDF5")


def test_a_broken_image_is_an_error(tmp_path):
    write_trajectories(tmp_path / "x", SPECS, TASKS, demonstrations(), {})
    with h5py.File(tmp_path / "x") as file:
        chunk = file["/domains/camera/obs/image"].id.get_chunk_info(0)
    content = bytearray((tmp_path / "x").read_bytes())
    content[chunk.byte_offset + 20] ^= 255
    (tmp_path / "x").write_bytes(content)
    first = validate_file(tmp_path / "x")[0]
    assert (first.severity, first.place) == ("error", "/domains/camera/obs/image")
