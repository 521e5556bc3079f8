"""Memory of this machine, and of processes, as Linux tells it."""

from __future__ import annotations

import contextlib
import math
import re
from pathlib import Path

MEMORY, GROUP = Path("/proc/meminfo"), Path("/sys/fs/cgroup")


def free_bytes() -> float:
    """Bytes that new processes may take, within the limit of this process's group; endless where nobody tells."""
    found = re.search(r"^MemAvailable: +(\d+) kB", _text(MEMORY), re.MULTILINE)
    free = int(found[1]) * 1024 if found else math.inf
    limit, used = _text(GROUP / "memory.max").strip(), _text(GROUP / "memory.current").strip()
    if limit.isdecimal() and used.isdecimal():
        cached = re.search(r"^inactive_file (\d+)", _text(GROUP / "memory.stat"), re.MULTILINE)
        free = min(free, int(limit) - int(used) + (int(cached[1]) if cached else 0))
    return free


def peak_bytes(process: int) -> int:
    """Most bytes that a process and those it began each had for themselves, without pages of files; 0 of what ended."""
    # Runs begin processes in their first thread; to ask dozens of threads at every look would keep a sweep busy.
    children = _text(Path(f"/proc/{process}/task/{process}/children")).split()
    return _own_peak(process) + sum(peak_bytes(int(child)) for child in children)


def _own_peak(process: int) -> int:
    told = dict(re.findall(r"^(\w+):\s+(\d+) kB", _text(Path(f"/proc/{process}/status")), re.MULTILINE))
    most, *shared = (int(told.get(name, 0)) for name in ("VmHWM", "RssFile", "RssShmem"))
    return max(0, most - sum(shared)) * 1024


def _text(file: Path) -> str:
    with contextlib.suppress(OSError):
        return file.read_text()
    return ""
