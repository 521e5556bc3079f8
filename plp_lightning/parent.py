"""PARENT: the kernel ends a process when the one ends that started it."""

from __future__ import annotations

import ctypes
import signal
import sys

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def end_with_parent() -> None:
    """Let this process be killed, even where it hangs, once the thread that started it has ended; on Linux alone.

    A parent that has ended before is not noticed.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
