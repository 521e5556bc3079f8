"""Progress of long jobs: a bar on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

SECONDS_BETWEEN_LINES = 10.0


class JobProgress:
    """Progress of one job of so many units of work; use as a context manager."""

    def __init__(self, label: str, total: int, unit: str) -> None:
        self.label, self.total, self.unit = label, total, unit
        self.done, self.began, self.last_line = 0, time.monotonic(), time.monotonic()
        self.console = Console()
        count = (BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeElapsedColumn(), TimeRemainingColumn())
        columns = (
            TextColumn("{task.description}", markup=False),
            *count,
            TextColumn("{task.fields[note]}", markup=False),
        )
        self.bar = Progress(*columns, console=self.console, disable=not self.console.is_terminal)
        self.row = self.bar.add_task(label, total=total, note="")

    def __enter__(self) -> JobProgress:
        self.bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self.bar.stop()
        if raised[0] is None and not self.console.is_terminal:
            self._line("done")

    def advance(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more units as done."""
        self.done += count
        self.bar.update(self.row, completed=self.done, note=note)
        if not self.console.is_terminal and time.monotonic() - self.last_line > SECONDS_BETWEEN_LINES:
            self._line(note)

    def tell(self, message: str) -> None:
        """Print a line about the job, above the bar where there is one."""
        self.console.print(f"{self.label}: {message}", markup=False, highlight=False, soft_wrap=True)

    def _line(self, note: str) -> None:
        self.last_line = time.monotonic()
        seconds = self.last_line - self.began
        told = f", {note}" if note else ""
        print(f"{self.label}: {self.done}/{self.total} {self.unit}, {seconds:.0f} s{told}", flush=True)
