"""Demonstrations of a run: collected if missing, finite, and the same from its first step to its last."""

from __future__ import annotations

import time

import torch

from datamodules.errors import TrajectoryFileError
from datamodules.transfer import TransferDataModule
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment


def prepare_demonstrations(experiment: Experiment, run: RunDirectory) -> None:
    """Collect missing demonstrations, check all of them, and write down the time that it took and their hash.

    Raises:
        TrajectoryFileError: If a value is not finite, or the demonstrations are not those that the run began with.
    """
    began = time.monotonic()
    try:
        experiment.data.prepare_data()
    finally:
        spent = run.status().get("collection_seconds", 0.0) + time.monotonic() - began
        run.write_json("status.json", run.status() | {"collection_seconds": spent})
    check_finite(experiment.data)
    run.write_json("status.json", run.status() | {"data_sha256": _same_fingerprint(experiment.data, run)})


def check_finite(data: TransferDataModule) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, states ``(N + L, O)`` and actions ``(N, A)`` that are not finite."""
    for domain, dataset in data.datasets.items():
        for name, values in (("observations", dataset.observation.state), ("actions", dataset.action)):
            if not torch.isfinite(values).all():
                found = f"{name} of domain {domain!r} hold values that are not finite"
                remedy = f"expected numbers: see plp data validate {data.path}"
                raise TrajectoryFileError(f"{data.path}: {found}; {remedy}")


def _same_fingerprint(data: TransferDataModule, run: RunDirectory) -> str:
    begun_with = run.status().get("data_sha256", data.fingerprint)
    if begun_with != data.fingerprint:
        found = f"the demonstrations have changed since the run at {run.path} began"
        hashes = f"SHA-256 {data.fingerprint[:12]}, expected {begun_with[:12]}"
        raise TrajectoryFileError(f"{data.path}: {found} ({hashes}); restore the file or begin a new run")
    return data.fingerprint
