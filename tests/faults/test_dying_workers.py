"""Processes that collect may die, fail, hang or be left alone: it is told, and none of them stays."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import chores
import pytest
from processes import gone, soon

from datamodules.errors import UserError
from plp_lightning.runs import workers
from plp_lightning.runs.workers import WorkError, Workers

TESTS = Path(__file__).parents[1]


def results(*jobs: str, count: int = 1) -> list[str]:
    with Workers[str, str](count, chores.work) as pool:
        return [found[1] for found in pool.results(jobs, print) if found]


def test_all_jobs_are_done_by_few_processes() -> None:
    found = results("a", "b", "c", count=2)
    assert sorted(text for text in found if text.endswith("done")) == ["a done", "b done", "c done"]
    assert len({text for text in found if text.isdigit()}) <= 2


@pytest.mark.parametrize("number", ["SIGKILL", "SIGSEGV"])
def test_a_process_that_dies_is_one_line_and_what_it_gave_is_kept(number: str) -> None:
    kept = []
    with Workers[str, str](1, chores.work) as pool, pytest.raises(WorkError) as caught:
        kept.extend(found for found in pool.results([number], print) if found)
    assert re.match(rf"process \d+, {number}, was killed by {number}", str(caught.value))
    assert "\n" not in str(caught.value)
    assert [job for job, _ in kept] in ([], [number])  # a pipe may lose what a killed process has not sent yet


def test_a_failure_is_told_with_its_kind_and_place() -> None:
    with pytest.raises(WorkError) as caught:
        results("raise")
    line = next(n for n, text in enumerate(Path(chores.__file__).read_text().splitlines(), 1) if "a bug" in text)
    assert str(caught.value) == f"raise failed: ZeroDivisionError: a bug of two lines ({chores.__file__}:{line})"


def test_a_simulator_that_raises_is_a_failure_of_the_job() -> None:
    with pytest.raises(WorkError, match=r"^break failed: str raised ZeroDivisionError at chores.py:\d+: unstable$"):
        results("break")


def test_a_users_mistake_comes_as_it_is() -> None:
    with pytest.raises(UserError, match=r"^mend it$"):
        results("complain")


def test_work_that_cannot_be_sent_is_a_users_mistake() -> None:
    with pytest.raises(UserError, match="cannot be sent to other processes"):
        Workers[str, str](1, lambda job: iter([job]))


def test_signals_to_all_processes_are_left_to_the_parent() -> None:
    """In a fresh interpreter, whose first process is special."""
    numbers = ["SIGINT", "SIGTERM", "SIGHUP", "SIGUSR1"]
    command = [sys.executable, "-m", "chores", *numbers]
    done = subprocess.run(command, cwd=TESTS, env=_environment(), capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert {f"{number} done" for number in numbers} <= {*done.stdout.splitlines()}


def test_a_process_that_stands_still_is_told_of_and_does_not_outlive_the_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(workers, "SILENT_SECONDS", 0.2)
    monkeypatch.setattr(workers, "TICK_SECONDS", 0.1)
    told: list[str] = []
    with Workers[str, str](1, chores.work) as pool:
        (process,) = (process.pid or 0 for process in pool.processes.values())
        waiting = pool.results(["SIGSTOP"], told.append)
        assert soon(lambda: next(waiting) is None and len(told) > 1)
        began = time.monotonic()
    assert time.monotonic() - began < 4
    assert gone(process)
    assert told[-1] == f"nothing for 0.2 s from process {process}, SIGSTOP"


def test_processes_go_with_their_killed_parent() -> None:
    command = [sys.executable, "-m", "chores", "sleep", "SIGSTOP"]
    with subprocess.Popen(command, cwd=TESTS, stdout=subprocess.PIPE, text=True, env=_environment()) as parent:
        assert parent.stdout is not None
        children: list[int] = []
        while len(children) < 2:
            line = parent.stdout.readline().strip()
            children += [int(line)] if line.isdigit() else []
        parent.send_signal(signal.SIGKILL)
    assert soon(lambda: all(map(gone, children)))


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
