"""Ranks that fail, are killed or asked to stop: all end, one line says why, and the run goes on from there."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from command import smoke_run, tiny_smoke
from ranks import codes, launched

LONG = ("--trainer.max_epochs", "200")


def training(folder: Path, run_root: Path, count: int = 2) -> list:
    """Ranks that have begun to train."""
    started = launched(["fit", *tiny_smoke(run_root), *LONG, "--trainer.devices", str(count)], folder)
    end = time.monotonic() + 60
    while not smoke_run(run_root).checkpoint("alignment").exists():
        assert time.monotonic() < end, (folder / "0").read_text()
        time.sleep(0.05)
    return started


def told(folder: Path, rank: int) -> str:
    return "".join(line for line in (folder / str(rank)).read_text().splitlines(True) if line.startswith("plp: "))


@pytest.mark.parametrize("victim", [0, 1])
def test_a_rank_that_is_killed_ends_all(victim: int, tmp_path: Path) -> None:
    started = training(tmp_path / "said", tmp_path / "runs")
    os.kill(started[victim].pid, signal.SIGKILL)
    found = codes(started)
    assert found[victim] == -signal.SIGKILL
    assert told(tmp_path / "said", 1) == ""
    if victim == 1:
        assert found[0] == 2
        assert told(tmp_path / "said", 0).count("\n") == 1
        assert "a rank has ended" in told(tmp_path / "said", 0)
        assert "Traceback" not in (tmp_path / "said" / "0").read_text()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
@pytest.mark.parametrize("heard", [[0], [1, 0]])
def test_ranks_that_are_asked_to_stop_save_and_end(number: signal.Signals, heard: list[int], tmp_path: Path) -> None:
    started = training(tmp_path / "said", tmp_path / "runs")
    for rank in heard:
        os.kill(started[rank].pid, number)
    found = codes(started)
    assert found[0] == 128 + number
    assert smoke_run(tmp_path / "runs").status()["state"] == "preempted"
