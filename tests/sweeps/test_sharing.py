"""Phases that runs have in common are trained once; demonstrations are collected once, always in the same order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from plp_lightning.sweeps.manifest import Job, stages, unmet
from plp_lightning.sweeps.sharing import PlannedRun, jobs_of

PHASES = ["alignment", "dynamics", "adaptation"]


def run(
    name: str, *decided: str, file: str = "a.hdf5", needs: str = "all", begun: bool = False, done: tuple[str, ...] = ()
) -> PlannedRun:
    words = ["fit", f"--seed={name}"]
    return PlannedRun(name, words, Path("runs") / name, PHASES, list(decided), Path(file), needs, False, begun, done)


def jobs(*runs: PlannedRun, known: Sequence[PlannedRun] = ()) -> dict[str, Job]:
    return {job.name: job for job in jobs_of(runs, Path("runs"), known)}


def test_the_longest_common_way_is_taken_from_the_first_that_went_it() -> None:
    found = jobs(run("x", "1", "12", "123"), run("y", "1", "12", "124"), run("z", "1", "13", "135"))
    assert found["x"].words == ["fit", "--seed=x"]
    assert found["y"].words[2:] == ["--phase", "adaptation", "--from", "runs/x"]
    assert found["z"].words[2:] == ["--phase", "dynamics,adaptation", "--from", "runs/x"]
    assert [found[name].after.get("x") for name in "xyz"] == [None, "dynamics", "alignment"]


def test_nothing_is_taken_where_nothing_is_common() -> None:
    found = jobs(run("x", "1", "12", "123"), run("y", "2", "22", "223"))
    assert all("--from" not in job.words for job in found.values())


def test_runs_that_have_begun_give_and_the_manifest_has_them_first() -> None:
    found = jobs(run("x", "1", "12", "123"), run("y", "1", "12", "124", begun=True))
    assert found["y"].words == ["fit", "--seed=y"]
    assert found["x"].words[-1] == "runs/y"
    assert [*found].index("y") < [*found].index("x")


def test_what_a_run_beside_them_is_done_with_is_taken_from_it_and_not_waited_for() -> None:
    ready = run("x", "1", "12", "123", begun=True, done=("alignment",))
    found = jobs(run("y", "1", "12", "124"), known=[ready, run("w", "1", "12", "125")])
    assert [*found] == ["collect a", "y"]
    assert found["y"].words[2:] == ["--phase", "dynamics,adaptation", "--from", "runs/x"]
    assert found["y"].begins_with == "alignment of x"
    assert "x" not in found["y"].after
    other = jobs(run("y", "1", "12", "124"), known=[replace(ready, done=())])
    assert other["y"].words == ["fit", "--seed=y"]


def test_each_need_of_a_file_is_collected_once_in_turn() -> None:
    runs = [run("x", "1", "2", "3"), run("y", "4", "5", "6", needs="more"), run("z", "7", "8", "9")]
    found = jobs(*runs, run("w", "a", "b", "c", file="b.hdf5"), run("v", "d", "e", "f", file="c.hdf5", needs=""))
    assert [*found][:3] == ["collect a", "collect a 2", "collect b"]
    assert found["collect a 2"].words == ["collect", "--seed=y"]
    assert [*found["collect a 2"].after] == ["collect a"]
    assert all([*found[name].after] == ["collect a", "collect a 2"] for name in "xyz")
    assert [*found["w"].after] == ["collect b"]
    assert not found["v"].after
    assert [[job.name for job in stage] for stage in stages([*found.values()])] == [
        ["collect a", "collect b", "v"],
        ["collect a 2", "w"],
        ["x", "y", "z"],
    ]


def test_a_job_waits_until_what_it_comes_after_is_done() -> None:
    found = jobs(run("x", "1", "12", "123"), run("y", "1", "12", "124"))
    states = dict.fromkeys(found, "waiting")
    assert unmet(found["y"], found, states, {}) == ["collect a", "x"]
    assert unmet(found["y"], found, states | {"collect a": "done"}, {"x": ["alignment"]}) == ["x"]
    assert unmet(found["y"], found, states | {"collect a": "done"}, {"x": ["alignment", "dynamics"]}) == []
    assert unmet(found["y"], found, states | {"collect a": "done", "x": "done"}, {}) == []
