"""Experts in simulators → demonstrations in a trajectory file, in parallel processes."""

from __future__ import annotations

import itertools
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from datamodules.errors import UserError
from datamodules.store.reader import TrajectoryFile, stored_count
from datamodules.store.recorder import Recorder
from datamodules.streams import episode_seed
from datamodules.types import Trajectory
from plp_lightning.envs.base import Domain
from plp_lightning.envs.cores import available_cores, available_processes
from plp_lightning.envs.demonstrator import Demonstrator
from plp_lightning.envs.pool import PooledSimulator
from plp_lightning.envs.rollout import rollout
from plp_lightning.runs.plans import CollectionConfig
from plp_lightning.runs.progress import JobProgress
from plp_lightning.runs.provenance import expert_differences, expert_record
from plp_lightning.runs.versions import versions
from plp_lightning.runs.workers import WorkError, Workers

_domains: Mapping[str, Domain] = {}
"""In a collecting process: the experiment's domains, whose simulators are built once for each process."""


WAVE = 32  # Attempts that are made together: enough for the simulators, few enough to come to an end in seconds
KEPT_SECONDS = 2.0  # Demonstrations that came in are on disk after at most so long …
KEPT_BYTES = 64 * 2**20  # … or when there are so many; the parent holds no more


@dataclass(frozen=True)
class Job:
    """Demonstrations of one task in one domain that are wanted."""

    domain: str
    task: str
    count: int
    known_seeds: frozenset[int]  # Seeds of the task's demonstrations that the file already holds

    def __str__(self) -> str:
        return f"demonstrating task {self.task!r} in domain {self.domain!r}"


class ExpertCollector:
    """Fills a trajectory file with demonstrations by the domains' experts; only successes are kept.

    Which demonstrations result depends on settings and seeds alone, not on how many processes made them or how often
    they were interrupted. Whatever ends the collection, what came in more than KEPT_SECONDS ago is kept.

    Args:
        domains: Simulators and experts by domain.
        collection: Settings by which demonstrations are made.
    """

    def __init__(self, domains: Mapping[str, Domain], collection: CollectionConfig) -> None:
        self.domains, self.collection = domains, collection

    def __call__(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> None:
        """Add ``missing[domain][task]`` demonstrations to the file at ``path``; if interrupted, those made so far."""
        self.check_experts(path, missing)
        first = next(iter(self.domains.values())).world
        specs = [domain.world.spec(name) for name, domain in self.domains.items()]
        with Recorder(path, specs, first.tasks.names, self._provenance()) as recorder:
            try:
                self._record(recorder, self._jobs(path, missing))
            except WorkError as error:
                raise WorkError(f"{error}; {_kept(recorder.added)}") from error

    def _record(self, recorder: Recorder, jobs: list[Job]) -> None:
        made, since = list[Trajectory](), time.monotonic()
        try:
            for more in self._collect(jobs):
                made += more
                late = time.monotonic() - since > KEPT_SECONDS
                if made and (late or sum(map(_bytes, made)) > KEPT_BYTES):
                    recorder.add(made)
                    made, since = [], time.monotonic()
        finally:
            if made:
                recorder.add(made)

    def check_experts(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> None:
        """Refuse, by a :class:`UserError`, if an expert of ``missing[domain][task]`` is not there or not for this."""
        for name, tasks in missing.items():
            domain = self.domains[name]
            if domain.expert is None:
                task, count = next(iter(tasks.items()))
                there = stored_count(path, name, task)
                held = f"which holds {there} of the {there + count} of task {task!r}"
                held = held if path.exists() else "which is not there"
                remedy = f"add one or import demonstrations into {path}, {held}"
                raise UserError(f"domain {name!r} has no expert; {remedy}")
            domain.expert.check(domain.world)

    def makes(self, domain: str) -> bool:
        """Tell whether the domain has an expert."""
        return self.domains[domain].expert is not None

    def check(self, path: Path) -> None:
        """Refuse a file that other settings or another expert filled: who changes a setting means its effect.

        Demonstrations that were imported are taken as they are.
        """
        # It knows checkpoints, and so torch, which the processes that collect do without.
        from plp_lightning.runs.specs import check_file

        check_file(path, [domain.world.spec(name) for name, domain in self.domains.items()])
        for made_by, experts in self._records(path):
            for name, (found, wanted) in self.collection.differences(made_by).items():
                _refuse(path, f"--collection.{name}", found, wanted)
            for name in self.domains.keys() & experts.keys():
                if (expert := self.domains[name].expert) and experts[name] != "NoneType":
                    for setting, (found, wanted) in expert_differences(expert, experts[name]).items():
                        _refuse(path, f"--domains.{name}.expert{setting}", found, wanted)

    def _records(self, path: Path) -> Iterator[tuple[Mapping[str, object], Mapping[str, object]]]:
        """Settings and experts that made the file's demonstrations of these domains."""
        with TrajectoryFile.open(path) as file:
            records = [file.provenance, *file.provenance.get("earlier", [])]
        for record in records:
            match record:
                case {"experts": dict(experts), "recipe": dict(made_by)} if self.domains.keys() & experts.keys():
                    yield made_by, experts

    def _jobs(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> list[Job]:
        known: dict[tuple[str, str], frozenset[int]] = {}
        if path.exists():
            with TrajectoryFile.open(path) as file:
                for domain in (spec.name for spec in file.domains):
                    table = file.episodes(domain)
                    known |= {(domain, t): frozenset(table.seed[table.task == t].tolist()) for t in file.tasks}
        pairs = [(domain, task, n) for domain, tasks in missing.items() for task, n in tasks.items()]
        return [Job(domain, task, n, known.get((domain, task), frozenset())) for domain, task, n in pairs]

    def _collect(self, jobs: list[Job]) -> Iterator[list[Trajectory]]:
        """Demonstrations as they are made; an empty list now and then, while none come."""
        cores, total = available_cores(), sum(job.count for job in jobs)
        processes = min(self.collection.processes or available_processes(), len(jobs))
        shares = max(1, cores // processes), max(1, available_processes() // processes)
        work = partial(_work, self.domains, shares, self.collection)
        with (
            JobProgress("collecting", total, "demonstrations") as progress,
            Workers[Job, list[Trajectory]](processes, work) as workers,
        ):
            for result in workers.results(jobs, progress.tell):
                if result is None:
                    yield []
                else:
                    job, made = result
                    progress.advance(len(made), f"{job.domain} {job.task}")
                    yield made

    def _provenance(self) -> dict[str, object]:
        experts = {
            name: expert_record(domain.expert) for name, domain in self.domains.items() if domain.expert is not None
        }
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        return {"command": command, "recipe": asdict(self.collection), "experts": experts, "versions": versions()}


def _refuse(path: Path, setting: str, found: object, wanted: object) -> NoReturn:
    told = f"{path}: its demonstrations were collected with {setting} {found}"
    raise UserError(f"{told}; expected {wanted}: restore the setting or name another --data.file")


def _kept(count: int) -> str:
    return f"the {count} demonstrations made before are kept; go on with the same command, plp fit with --resume"


def _bytes(made: Trajectory) -> int:
    return sum(array.nbytes for array in (made.observation.state, *made.observation.images.values(), made.actions))


def _work(
    domains: Mapping[str, Domain], shares: tuple[int, int], collection: CollectionConfig, job: Job
) -> Iterator[list[Trajectory]]:
    if _domains is not domains:
        _begin_process(domains, *shares)
    return demonstrate(job, collection)


def _begin_process(domains: Mapping[str, Domain], threads: int, processes: int = 1) -> None:
    """The processes share the cores; where tasks are fewer than cores, each gets several for its physics."""
    globals()["_domains"] = domains
    for domain in domains.values():
        domain.world.threads = processes if isinstance(domain.world, PooledSimulator) else threads


def demonstrate(job: Job, collection: CollectionConfig) -> Iterator[list[Trajectory]]:
    """The first ``job.count`` successes among the attempts, in their order: ``(T + 1, O)`` states, ``(T, A)`` actions.

    They come in waves, as they are made.

    Raises:
        UserError: If the expert fails so often that ``collection.attempts`` times the wanted number don't suffice.
    """
    made = attempts = 0
    seeds = (episode_seed("collect", collection.seed, job.domain, job.task, i) for i in itertools.count())
    unknown = (seed for seed in seeds if seed not in job.known_seeds)
    while made < job.count:
        # Failures of the attempts that led to the known ones are repeated, so they count too.
        if attempts >= collection.attempts * (job.count + len(job.known_seeds)) + 10:
            found = f"expert of domain {job.domain!r} solved task {job.task!r} {made} times in {attempts} attempts"
            remedy = "mend the expert or raise --collection.attempts"
            raise UserError(f"{found}; {job.count} demonstrations were asked for; {remedy}")
        wave = list(itertools.islice(unknown, min(WAVE, max(4, job.count - made))))
        solved = _attempt(job, wave, collection)[: job.count - made]
        made, attempts = made + len(solved), attempts + len(wave)
        if solved:
            yield solved


def _attempt(job: Job, seeds: list[int], collection: CollectionConfig) -> list[Trajectory]:
    domain = _domains[job.domain]
    tasks = [job.task] * len(seeds)
    demonstrator = Demonstrator(domain, collection.noise, collection.noise_steps, collection.random_start_steps)
    episodes = rollout(domain.world, demonstrator.act, tasks, seeds, collection.hold_steps, [demonstrator])
    solved = np.flatnonzero(episodes.success & (episodes.steps > collection.random_start_steps))
    return [_trajectory(job, demonstrator, int(i)) for i in solved]


def _trajectory(job: Job, demonstrator: Demonstrator, index: int) -> Trajectory:
    seed = demonstrator.seeds[index]
    return Trajectory(job.domain, job.task, *demonstrator.episode(index), seed=seed, success=True)
