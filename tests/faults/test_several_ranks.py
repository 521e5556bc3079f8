"""Ranks that fail, are killed or asked to stop: all end, one line says why, and the run goes on from there."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest
from command import dies, smoke_run, tiny_smoke
from ranks import codes, launched

from datamodules.errors import UserError

STEP = "plp_lightning.callbacks.guard:FiniteGuard.on_train_batch_end"
LONG = ("--trainer.max_epochs", "200")


def training(folder: Path, run_root: Path, count: int = 2) -> list[BaseProcess]:
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


@pytest.mark.parametrize(("number", "heard"), [(signal.SIGTERM, [1, 0]), (signal.SIGUSR1, [0])])
def test_ranks_that_are_asked_to_stop_save_and_end(number: signal.Signals, heard: list[int], tmp_path: Path) -> None:
    started = training(tmp_path / "said", tmp_path / "runs")
    for rank in heard:
        os.kill(started[rank].pid, number)
    found = codes(started)
    assert found[0] == 128 + number
    assert smoke_run(tmp_path / "runs").status()["state"] == "preempted"


def test_a_fault_of_another_rank_is_told_by_the_first(tmp_path: Path) -> None:
    words = ["fit", *tiny_smoke(tmp_path / "runs"), "--trainer.devices", "2"]
    started = launched(words, tmp_path / "said", moment=(1, STEP, 5, UserError("here it fails")))
    assert codes(started) == [2, 2]
    assert told(tmp_path / "said", 0) == (
        "plp: rank 1: here it fails; expected all ranks to stay: go on with plp fit --resume RUN_DIR\n"
    )
    assert told(tmp_path / "said", 1) == ""


def test_a_fault_of_all_ranks_is_told_once(tmp_path: Path) -> None:
    words = ["fit", *tiny_smoke(tmp_path / "runs"), "--trainer.devices", "2", "--alignment.optimizer.lr", "1e30"]
    assert codes(launched(words, tmp_path / "said")) == [2, 2]
    assert told(tmp_path / "said", 0).count("\n") == 1
    assert "is not finite" in told(tmp_path / "said", 0)
    assert (tmp_path / "said" / "1").read_text() == ""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--trainer.devices", "3"], "trainer.devices is 3, and 2 processes were started together; expected as many"),
        (["--trainer.devices", "2", "--data.batch_sise", "3"], "batch_sise"),
        (["--trainer.devices", "2", "--data.batch_size", "1"], "trainer.devices is 2, more than the 1 rows of a batch"),
    ],
)
def test_mistakes_are_told_by_the_first_rank_alone(words: list[str], expected: str, tmp_path: Path) -> None:
    started = launched(["fit", *tiny_smoke(tmp_path / "runs"), *words], tmp_path / "said")
    assert codes(started) == [2, 2]
    assert told(tmp_path / "said", 0).count("\n") == 1
    assert expected in told(tmp_path / "said", 0)
    assert (tmp_path / "said" / "1").read_text() == ""


def left_over(folder: Path) -> list[str]:
    """Commands of processes that have something to do with a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            found.append(place.read_bytes().replace(b"\0", b" ").decode())
    return [command for command in found if str(folder) in command]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_ranks_that_the_first_has_started_end_with_it(number: signal.Signals, tmp_path: Path) -> None:
    words = ["fit", *tiny_smoke(tmp_path), "--trainer.devices", "2"]
    assert dies(words, STEP, 5, number) == (-number if number == signal.SIGKILL else 128 + number)
    end = time.monotonic() + 20
    while left := left_over(tmp_path):
        assert time.monotonic() < end, left
        time.sleep(0.1)
