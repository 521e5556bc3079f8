"""Facts that a measurement is worth nothing without: machine, load, versions, commit."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from plp_lightning.envs.cores import available_cores
from plp_lightning.runs.gpus import gpus
from plp_lightning.runs.versions import commit, versions


def machine(device: str) -> dict[str, Any]:
    """Processor, cores, load of the last minute, commit, versions of packages, and the GPU if that is the device."""
    return {
        "processor": processor(),
        "cores": available_cores(),
        "gpus": gpus()["usable"] if device == "cuda" else [],
        "load": os.getloadavg()[0],
        "commit": commit(),
        "versions": versions(),
    }


def processor() -> str:
    """Name of the processor."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
