"""Phases that several runs have in common: trained by the first of them, taken from there by the others.

Example:
    Two target tasks of the same proxy tasks, with the same seed and settings, need one alignment. The first run trains
    it; the second begins with ``--phase adaptation --from`` the first one's directory.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from plp_lightning.sweeps.manifest import Job


@dataclass(frozen=True)
class PlannedRun:
    """A run as its configuration describes it, before anything is shared."""

    name: str
    words: list[str]  # of plp, the verb first
    directory: Path
    phases: list[str]  # in order
    decided: list[str]  # hash of all that decides the policy after each phase
    file: Path  # of the demonstrations
    collection: str  # hash of the demonstrations that it needs; empty if nobody can make any
    complete: bool  # the file has them
    independent: bool = False  # has begun, and trains all of its phases
    done: Sequence[str] = ()  # phases that it is done with


def jobs_of(runs: Sequence[PlannedRun], root: Path, known: Iterable[PlannedRun] = ()) -> list[Job]:
    """Collections, then runs; each after what it waits for.

    Args:
        runs: Runs to do.
        root: Folder of logs of collections.
        known: Further runs. None of them becomes a job; phases that they are done with are taken from them, too.
    """
    collections = list(_collections(runs, root))
    of_file = {run.file: [job.name for job, file in collections if file == run.file] for run in runs}
    names = {run.name for run in runs}
    givers = _givers(runs, [run for run in known if run.name not in names])
    shared = [_run(run, givers, of_file[run.file], names) for run in runs]
    return [job for job, _ in collections] + _ordered(shared)


def _givers(runs: Sequence[PlannedRun], known: Iterable[PlannedRun]) -> dict[str, PlannedRun]:
    """The run that trains a phase, by the hash of what decides it: one that has done so or begun before one to come."""
    givers: dict[str, PlannedRun] = {}
    offers = [(decided, run) for run in runs if run.independent for decided in run.decided]
    for run in known:
        pairs = zip(run.phases, run.decided, strict=True)
        offers += [(decided, run) for phase, decided in pairs if phase in run.done]
    offers += [(decided, run) for run in runs for decided in run.decided]
    for decided, run in offers:
        givers.setdefault(decided, run)
    return givers


def _collections(runs: Iterable[PlannedRun], root: Path) -> Iterator[tuple[Job, Path]]:
    """One collection for every different need of each file, one after the other: so a file is always the same."""
    before: dict[Path, dict[str, str]] = {}
    for run in runs:
        known = before.setdefault(run.file, {})
        if run.collection and run.collection not in known:
            name = f"collect {run.file.stem}" + (f" {len(known) + 1}" if known else "")
            log = root / f"{name.replace(' ', '_')}.log"
            words = ["collect", *run.words[1:]]
            yield Job(name, words, str(log), after=dict.fromkeys(known.values()), done=run.complete), run.file
            known[run.collection] = name


def _run(run: PlannedRun, givers: dict[str, PlannedRun], collections: Sequence[str], names: Container[str]) -> Job:
    log = run.directory.with_name(f"{run.directory.name}.log")
    after: dict[str, str | None] = dict.fromkeys(collections)
    words, begins_with = run.words, ""
    for phase, rest, decided in reversed([*zip(run.phases, _rests(run.phases), run.decided, strict=True)][:-1]):
        giver = givers[decided]
        if giver is run:
            continue
        words = [*words, "--phase", ",".join(rest), "--from", str(giver.directory)]
        begins_with = f"{phase} of {giver.name}"
        after |= {giver.name: phase} if giver.name in names else {}
        break
    return Job(run.name, words, str(log), str(run.directory), after, begins_with)


def _rests(phases: Sequence[str]) -> list[list[str]]:
    return [list(phases[i + 1 :]) for i in range(len(phases))]


def _ordered(jobs: list[Job]) -> list[Job]:
    """Those that others wait for first, otherwise in their order."""
    names, placed, ordered = {job.name for job in jobs}, set[str](), list[Job]()
    while waiting := [job for job in jobs if job.name not in placed]:
        ready = [job for job in waiting if not (names & job.after.keys()) - placed]
        ordered += ready
        placed |= {job.name for job in ready}
    return ordered
