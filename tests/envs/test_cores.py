"""Processes that may step environments side by side."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from command import complaint

from datamodules.errors import ConfigError
from plp_lightning.envs.base import Domain
from plp_lightning.envs.cores import PROCESSES, available_cores, available_processes
from plp_lightning.envs.gym.simulator import Gymnasium
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.runs import collection


@pytest.fixture(autouse=True)
def many_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine of 64 cores."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(64))
    monkeypatch.delenv(PROCESSES, raising=False)


def test_processes_are_no_more_than_sixteen_unless_it_is_said() -> None:
    assert (available_cores(), available_processes()) == (64, 16)


@pytest.mark.parametrize(("told", "found"), [("40", 40), ("065", 64), ("1", 1), ("999999999", 64)])
def test_processes_are_as_many_as_is_said_and_there_are_cores(
    monkeypatch: pytest.MonkeyPatch, told: str, found: int
) -> None:
    monkeypatch.setenv(PROCESSES, told)
    assert available_processes() == found


def test_one_core_has_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3})
    assert available_processes() == 1


@pytest.mark.parametrize("told", ["", "0", "-2", "2.0", "two", "٢", "9" * 5000])
def test_other_words_are_refused(monkeypatch: pytest.MonkeyPatch, told: str) -> None:
    monkeypatch.setenv(PROCESSES, told)
    with pytest.raises(ConfigError, match=r"^PLP_PROCESSES is '.*'; expected a number of processes, from 1 on"):
        available_processes()


def test_a_command_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "all")
    told = complaint("collect", "--config", "smoke", "--data.root", tmp_path)
    assert told == "plp: PLP_PROCESSES is 'all'; expected a number of processes, from 1 on; unset it\n"


def test_environments_are_stepped_by_no_more_processes_than_are_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "2")
    assert Gymnasium("Reacher-v5", ["reach"])._pool.count == 2


def test_collecting_processes_share_threads_and_processes() -> None:
    stepped_by_processes, stepped_by_threads = Gymnasium("Reacher-v5", ["reach"]), LinearPoint(1)
    collection._begin_process({"a": Domain(stepped_by_processes), "b": Domain(stepped_by_threads)}, 7, 3)
    assert (stepped_by_processes.threads, stepped_by_threads.threads) == (3, 7)
