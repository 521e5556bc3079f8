"""State of a sweep: a table that is alive on a terminal, a line for each change in a log."""

from __future__ import annotations

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Sequence

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from datamodules.words import visible
from plp_lightning.sweeps.manifest import Job

STATES = ("done", "running", "waiting", "failed", "blocked")
MOST = 12  # Rows that are shown of each kind


class SweepProgress:
    """States of all jobs, shown as they change; use as a context manager.

    Args:
        jobs: The jobs.
        places: Jobs that run at a time, by which the rest is estimated.
    """

    def __init__(self, jobs: Sequence[Job], places: int) -> None:
        self.jobs = {job.name: job for job in jobs}
        self.states = {job.name: "done" if job.state() == "done" else "waiting" for job in jobs}
        self.places, self.reasons = places, dict[str, str]()
        self.began = dict[str, float]()
        self.seconds = defaultdict[str, list[float]](list)  # of finished jobs, by kind
        for name, state in self.states.items():
            if state == "done":
                self._learn(name)
        self.console = Console(stderr=True)
        self.live = Live(console=self.console, auto_refresh=False) if self.console.is_terminal else None

    def __enter__(self) -> SweepProgress:
        if self.live is not None:
            self.live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        if self.live is not None:
            self.live.stop()

    def set(self, name: str, state: str, reason: str = "") -> None:
        """Note a job's new state, and the reason if it has one."""
        before, self.states[name] = self.states[name], state
        if reason:
            self.reasons[name] = reason
        if state == "running":
            self.began[name] = time.monotonic()
        if state == "done":
            self._learn(name)
        if self.live is None and (state != before or reason):
            print(visible(f"{name}: {self._told(name)}; {self.summary()}"), file=sys.stderr, flush=True)

    def refresh(self) -> None:
        """Draw the table anew, where there is one."""
        if self.live is not None:
            self.live.update(Group(self._table(), Text(self.summary())), refresh=True)

    def summary(self) -> str:
        """Number of jobs that are done, and the time that is left as finished ones let expect."""
        counts = Counter(self.states.values())
        told = [f"{counts[state]} {state}" for state in STATES if counts[state] or state == "done"]
        left = self.seconds_left()
        return f"{', '.join(told)} of {len(self.jobs)}" + ("" if left is None else f"; about {_duration(left)} left")

    def seconds_left(self) -> float | None:
        """Seconds until all jobs are over, as long as the finished ones of their kind took; None before one is."""
        known = [seconds for kind in self.seconds.values() for seconds in kind]
        open_ = [name for name, state in self.states.items() if state in ("running", "waiting")]
        if not known or not open_:
            return None
        left = [self._expected(name, sum(known) / len(known)) for name in open_]
        return max(max(left), sum(left) / min(self.places, len(open_)))

    def _expected(self, name: str, otherwise: float) -> float:
        seconds = self.seconds.get(self._kind(name))
        whole = sum(seconds) / len(seconds) if seconds else otherwise
        spent = time.monotonic() - self.began[name] if self.states[name] == "running" else 0.0
        return max(0.0, whole - spent)

    def _kind(self, name: str) -> str:
        """Jobs of a kind take about as long: those of an experiment and a method that train the same phases."""
        begins = any(self.jobs[name].after.values())
        return f"{name.rsplit('/', 2)[0]}{' from a phase' if begins else ''}"

    def _learn(self, name: str) -> None:
        run = self.jobs[name].run
        if name in self.began:
            self.seconds[self._kind(name)].append(time.monotonic() - self.began[name])
        elif run is not None:
            spent = run.read_json(run.results.name).get("seconds", {})
            self.seconds[self._kind(name)].append(sum(float(x) for x in spent.values()))

    def _told(self, name: str) -> str:
        state = self.states[name]
        took = f" in {_duration(time.monotonic() - self.began[name])}" if name in self.began and state == "done" else ""
        reason = f": {self.reasons[name]}" if name in self.reasons and state != "done" else ""
        return state + took + reason

    def _table(self) -> Table:
        table = Table(box=None, show_header=False)
        for state in ("running", "failed", "blocked"):
            names = [name for name, found in self.states.items() if found == state]
            for name in names[:MOST]:
                spent = _duration(time.monotonic() - self.began[name]) if state == "running" else ""
                table.add_row(*(Text(visible(cell)) for cell in (name, state, spent or self.reasons.get(name, ""))))
            if len(names) > MOST:
                table.add_row("…", state, f"and {len(names) - MOST} more")
        return table


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
