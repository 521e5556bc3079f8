"""Cores that a run may compute on, and processes that it may start on them."""

from __future__ import annotations

import os
import re

from datamodules.errors import ConfigError

PROCESSES, MOST = "PLP_PROCESSES", 16  # Variable of the environment, and what holds where it is not set


def available_cores() -> int:
    """Cores that the scheduler grants this process, which containers and batch queues restrict."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def available_processes() -> int:
    """Processes that step environments side by side: one a core, and no more than ``PLP_PROCESSES``, or else 16.

    Each holds worlds of its own, half a gigabyte of robosuite's, for each domain. So neither a run on a machine of many
    cores nor the runs of a sweep, which are given shares, can have as many as there are cores. Threads hold nothing.

    Raises:
        ConfigError: If ``PLP_PROCESSES`` is no number from 1 on.
    """
    told = os.environ.get(PROCESSES, str(MOST))
    if not re.fullmatch(r"0*[1-9]\d{0,8}", told, re.ASCII):
        raise ConfigError(f"{PROCESSES} is {told!r}; expected a number of processes, from 1 on; unset it")
    return min(int(told), available_cores())
