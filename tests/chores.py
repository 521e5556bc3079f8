"""Work for processes of their own, which import little: what may happen to those that collect."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator

from datamodules.errors import UserError
from plp_lightning.envs.faults import blaming
from plp_lightning.runs.workers import Workers


def work(job: str) -> Iterator[str]:
    """Do what the job says, after a first result that tells the process."""
    yield str(os.getpid())
    if job == "raise":
        raise ZeroDivisionError("a bug\nof two lines")
    if job == "break":
        with blaming(job):
            raise ZeroDivisionError("unstable")
    if job == "complain":
        raise UserError("mend it")
    if job == "sleep":
        time.sleep(600)
    if job.startswith("SIG"):
        os.kill(os.getpid(), signal.Signals[job])
        time.sleep(0.1)
    yield f"{job} done"


def serve(jobs: list[str]) -> None:
    """Print all results of jobs, each done by a process of its own."""
    with Workers[str, str](len(jobs), work) as workers:
        for found in workers.results(jobs, print):
            print(found[1] if found else "", flush=True)


if __name__ == "__main__":
    serve(sys.argv[1:])
