"""The manifest of a sweep: one job a line, with its words for ``plp``, its places and what it waits for."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from datamodules.store.atomic import write_atomically
from plp_lightning.runs.directory import RunDirectory


@dataclass(frozen=True)
class Job:
    """A process of ``plp``: a run, or the collection of demonstrations that runs need."""

    name: str  # of a run: its directory below the sweep's root
    words: list[str]  # of plp, the verb first
    log: str  # file that gets what the process says
    directory: str | None = None  # of the run; None for a collection
    after: dict[str, str | None] = field(default_factory=dict)
    """Jobs that have to be done before, by name; where a phase is named, that phase of the run is enough."""
    begins_with: str = ""  # the last phase that it takes from another run, and whose
    done: bool = False  # when the manifest was written

    @property
    def run(self) -> RunDirectory | None:
        """The run directory, if the run has begun."""
        run = None if self.directory is None else RunDirectory(Path(self.directory))
        return run if run is not None and run.config.exists() else None

    def state(self) -> str:
        """``new``, ``begun`` or ``done``, as the run directory says."""
        run = self.run
        if run is None:
            return "done" if self.done else "new"
        return "done" if run.status()["state"] == "done" and run.results.exists() else "begun"

    def next_words(self) -> list[str]:
        """Words of ``plp`` that begin the job, or go on with it where it has stopped."""
        if self.run is None:
            return self.words
        trusted = [word for word in self.words if word.startswith("--allow_imports=")]
        return ["fit", "--resume", str(self.directory), *trusted]

    def done_phases(self) -> list[str]:
        """Phases of the run that are done."""
        run = self.run
        return [] if run is None else run.done_phases()


def write_manifest(path: Path, jobs: Iterable[Job]) -> None:
    """Write jobs as JSON lines, in an order in which each comes after those that it waits for."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, "".join(json.dumps(asdict(job)) + "\n" for job in jobs))


def stages(jobs: Sequence[Job]) -> list[list[Job]]:
    """Jobs by the number of jobs that they come after, one behind the other."""
    depth: dict[str, int] = {}
    for job in jobs:
        depth[job.name] = max((1 + depth.get(name, -1) for name in job.after), default=0)
    return [[job for job in jobs if depth[job.name] == n] for n in range(max(depth.values(), default=-1) + 1)]


def unmet(job: Job, jobs: Mapping[str, Job], states: Mapping[str, str], phases: dict[str, list[str]]) -> list[str]:
    """Names of the jobs that a job still waits for; ``phases`` keeps what their records say is done."""
    waiting = {name: phase for name, phase in job.after.items() if states[name] != "done"}
    for name in waiting.keys() - phases.keys():
        phases[name] = jobs[name].done_phases()
    return [name for name, phase in waiting.items() if phase not in phases[name]]
