"""The number of cores that this process may use."""

from __future__ import annotations

import os


def available_cores() -> int:
    """Cores that the scheduler grants this process, which containers and batch queues restrict."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
