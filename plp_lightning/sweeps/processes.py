"""Processes of ``plp`` that work on jobs; each has a log, and none outlives the process that started it."""

from __future__ import annotations

import contextlib
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from datamodules.words import one_line
from plp_lightning.sweeps.manifest import Job

PATIENCE = 60.0  # s that a process has to save and leave when it is asked to
LAST = 4096  # Bytes of a log in which its last words are looked for


class JobProcess:
    """A process that begins a job or goes on with it; what it says is appended to the job's log.

    Args:
        job: The job.
        environment: Variables of the environment, beside those of this process.
    """

    def __init__(self, job: Job, environment: Mapping[str, str]) -> None:
        self.job, self.began, self.log = job, time.monotonic(), Path(job.log)
        words, command = job.next_words(), [sys.executable, "-m", "plp_lightning"]
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            log.write(f"$ {shlex.join(['plp', *words])}\n".encode())
            log.flush()
            self.process = subprocess.Popen(
                [sys.executable, "-m", "plp_lightning.sweeps.bound", str(os.getpid()), *command, *words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment},
                start_new_session=True,  # a terminal's signals come to the sweep, which hands them on
            )

    @property
    def seconds(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.began


def last_words(log: Path) -> str:
    """The last complaint of ``plp`` in a log, or else its last line."""
    if not log.exists():
        return "it never began"
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - LAST))
        lines = [line for line in file.read().decode(errors="replace").splitlines() if line.strip()]
    told = [line for line in lines if line.startswith("plp: ")]
    return one_line((told or lines or [""])[-1].removeprefix("plp: "))


def stop(processes: Sequence[JobProcess]) -> None:
    """Ask processes to save and leave, and end those that don't; at once if another signal comes meanwhile."""
    running = [process.process for process in processes]
    for process in running:
        process.terminate()
    try:
        until = time.monotonic() + PATIENCE
        for process in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, until - time.monotonic()))
    finally:
        for process in running:
            process.kill()
            process.wait()
