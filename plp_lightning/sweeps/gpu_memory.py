"""Memory of GPUs, as NVIDIA's driver tells it to its own program: asking makes no context, which would take some."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Collection

ASK = ("nvidia-smi", "--format=csv,noheader,nounits")
LIMIT = 60.0  # s that a broken driver may keep an answer waiting
STANDS = 2.0  # s for which an answer stands


class GpuMemory:
    """Tells whether one more run has room on a GPU beside those that are there."""

    def __init__(self) -> None:
        self.asked, self.gpus, self.processes = -STANDS, list[list[str]](), list[list[str]]()

    def has_room(self, gpu: str, running: Collection[int]) -> bool:
        """Tell whether no less is free on a GPU than the largest of the processes ``running`` there holds.

        True if nobody tells. Where the driver knows processes by other numbers, as in containers, each is taken to hold
        an equal share of all that is used.

        Args:
            gpu: Number or UUID, as in CUDA_VISIBLE_DEVICES.
            running: Numbers of processes.
        """
        self._ask()
        for index, uuid, used, free in self.gpus:
            if (gpu == index or uuid.startswith(gpu)) and used.isdecimal() and free.isdecimal():
                return int(free) >= max(self._held(uuid, running), default=int(used) / len(running))
        return True

    def _held(self, uuid: str, running: Collection[int]) -> list[int]:
        """MiB that each of these processes holds on a GPU, of those that are known."""
        rows = [(pid, held) for where, pid, held in self.processes if where == uuid and f"{pid}{held}".isdecimal()]
        return [int(held) for pid, held in rows if int(pid) in running]

    def _ask(self) -> None:
        if time.monotonic() - self.asked >= STANDS:
            self.gpus = _rows("--query-gpu=index,uuid,memory.used,memory.free", 4)
            self.processes = _rows("--query-compute-apps=gpu_uuid,pid,used_memory", 3)
            self.asked = time.monotonic()


def _rows(query: str, columns: int) -> list[list[str]]:
    """Rows of an answer, amounts in MiB; none if there is none."""
    try:
        told = subprocess.run(
            [*ASK, query], capture_output=True, text=True, errors="replace", timeout=LIMIT, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return []
    rows = [[cell.strip() for cell in line.split(",")] for line in told.stdout.splitlines()]
    return [row for row in rows if len(row) == columns]
