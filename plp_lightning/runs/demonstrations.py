"""Demonstrations of a run: collected if missing, and the same from its first step to its last."""

from __future__ import annotations

import sys
import time

from datamodules.errors import TrajectoryFileError
from datamodules.transfer import TransferDataModule
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.roles import left_out


def prepare_demonstrations(experiment: Experiment, run: RunDirectory) -> None:
    """Collect missing demonstrations, read all of them, and write down the time that it took and their hash.

    Raises:
        TrajectoryFileError: If the file is damaged, or the demonstrations are not those that the run began with.
    """
    began = time.monotonic()
    try:
        experiment.data.prepare_data()
    finally:
        spent = run.status().get("collection_seconds", 0.0) + time.monotonic() - began
        run.write_json("status.json", run.status() | {"collection_seconds": spent})
    for task, domain in left_out(experiment.data).items():
        print(
            f"task {task!r} is left out: {experiment.data.path} shows none of it in domain {domain!r}", file=sys.stderr
        )
    run.write_json("status.json", run.status() | {"data_sha256": check_fingerprint(experiment.data, run)})


def check_fingerprint(data: TransferDataModule, run: RunDirectory) -> str:
    """Hash of the demonstrations; a :class:`TrajectoryFileError` says if the run began with others."""
    begun_with = run.status().get("data_sha256", data.fingerprint)
    if begun_with != data.fingerprint:
        found = f"the demonstrations have changed since the run at {run.path} began"
        hashes = f"SHA-256 {data.fingerprint[:12]}, expected {begun_with[:12]}"
        raise TrajectoryFileError(f"{data.path}: {found} ({hashes}); restore the file or begin a new run")
    return data.fingerprint
