"""Experts in simulators → demonstrations in a trajectory file, in parallel processes."""

from __future__ import annotations

import itertools
import multiprocessing
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from datamodules.errors import UserError
from datamodules.store.writer import TrajectoryFile, add_trajectories
from datamodules.streams import EpisodeStream, episode_generator, episode_seed
from datamodules.types import Observation, Trajectory
from plp_lightning.envs.base import Domain, Step, available_cores
from plp_lightning.envs.rollout import Observer, rollout
from plp_lightning.runs.plans import CollectionConfig
from plp_lightning.runs.progress import JobProgress
from plp_lightning.runs.specs import check_file
from plp_lightning.runs.versions import versions

_domains: Mapping[str, Domain] = {}
"""In a collecting process: the experiment's domains, whose simulators are built once for each process."""


@dataclass(frozen=True)
class Job:
    """Demonstrations of one task in one domain that are wanted."""

    domain: str
    task: str
    count: int
    known_seeds: frozenset[int]  # Seeds of demonstrations that the file already holds


class ExpertCollector:
    """Fills a trajectory file with demonstrations by the domains' experts; only successes are kept.

    Which demonstrations result depends on the recipe alone, not on how many processes made them.

    Args:
        domains: Simulators and experts by domain.
        recipe: Recipe of demonstrations.
    """

    def __init__(self, domains: Mapping[str, Domain], recipe: CollectionConfig) -> None:
        self.domains, self.recipe = domains, recipe

    def __call__(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> None:
        """Add ``missing[domain][task]`` demonstrations to the file at ``path``; if interrupted, those made so far."""
        without = [name for name in missing if self.domains[name].expert is None]
        if without:
            raise UserError(f"domain {without[0]!r} has no expert; add one or import demonstrations into {path}")
        for domain in (self.domains[name] for name in missing):
            domain.expert.check(domain.simulator)  # type: ignore[union-attr]
        first = next(iter(self.domains.values())).simulator
        specs = [domain.simulator.spec(name) for name, domain in self.domains.items()]
        made: list[Trajectory] = []
        try:
            made.extend(self._collect(self._jobs(path, missing)))  # one by one: those made before a stop are kept
        except UserError:
            made.clear()  # settings will have to change, and a file holds demonstrations of one recipe
            raise
        finally:
            if made:
                add_trajectories(path, specs, first.tasks.names, made, self._provenance())

    def check(self, path: Path) -> None:
        """Refuse a file whose demonstrations another recipe made: who changes a setting means to see its effect.

        Demonstrations that were imported are taken as they are.
        """
        check_file(path, [domain.simulator.spec(name) for name, domain in self.domains.items()])
        for recipe in self._recipes(path):
            for name, (found, wanted) in self.recipe.differences(recipe).items():
                told = f"{path}: its demonstrations were collected with --collection.{name} {found}"
                raise UserError(f"{told}; expected {wanted}: restore the setting or name another --data.file")

    def _recipes(self, path: Path) -> Iterator[Mapping[str, object]]:
        """Recipes by which experts of this project made demonstrations of the domains."""
        with TrajectoryFile.open(path) as file:
            records = [file.provenance, *file.provenance.get("earlier", [])]
        for record in records:
            match record:
                case {"experts": dict(experts), "recipe": dict(recipe)} if self.domains.keys() & experts.keys():
                    yield recipe

    def _jobs(self, path: Path, missing: Mapping[str, Mapping[str, int]]) -> list[Job]:
        known: dict[str, frozenset[int]] = {}
        if path.exists():
            with TrajectoryFile.open(path) as file:
                known = {s.name: frozenset(map(int, file.episodes(s.name).seed)) for s in file.domains}
        pairs = [(domain, task, n) for domain, tasks in missing.items() for task, n in tasks.items()]
        return [Job(domain, task, n, known.get(domain, frozenset())) for domain, task, n in pairs]

    def _collect(self, jobs: list[Job]) -> Iterator[Trajectory]:
        cores = available_cores()
        total, processes = sum(job.count for job in jobs), min(self.recipe.processes or cores, len(jobs))
        begin = partial(_begin_process, self.domains, max(1, cores // processes))
        with (
            JobProgress("collecting", total, "demonstrations") as progress,
            ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), begin) as pool,
        ):
            futures: dict[Future[list[Trajectory]], Job] = {pool.submit(demonstrate, j, self.recipe): j for j in jobs}
            try:
                for future in as_completed(futures):
                    made = future.result()
                    progress.advance(len(made), f"{futures[future].domain} {futures[future].task}")
                    yield from made
            except BaseException:
                pool.shutdown(cancel_futures=True)  # no use in the rest if one task can't be had
                raise

    def _provenance(self) -> dict[str, object]:
        experts = {name: type(domain.expert).__name__ for name, domain in self.domains.items()}
        command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        return {"command": command, "recipe": asdict(self.recipe), "experts": experts, "versions": versions()}


def _begin_process(domains: Mapping[str, Domain], threads: int) -> None:
    """The processes share the cores; where tasks are fewer than cores, each gets several for its physics."""
    globals()["_domains"] = domains
    for domain in domains.values():
        domain.simulator.threads = threads


def demonstrate(job: Job, recipe: CollectionConfig) -> list[Trajectory]:
    """The first ``job.count`` successes among the attempts, in their order: ``(T + 1, O)`` states, ``(T, A)`` actions.

    Raises:
        UserError: If the expert fails so often that ``recipe.attempts`` times the wanted number don't suffice.
    """
    made, attempts = list[Trajectory](), 0
    seeds = (episode_seed("collect", recipe.seed, job.domain, job.task, i) for i in itertools.count())
    unknown = (seed for seed in seeds if seed not in job.known_seeds)
    while len(made) < job.count:
        if attempts >= recipe.attempts * job.count + 10:
            found = f"expert of domain {job.domain!r} solved task {job.task!r} {len(made)} times in {attempts} attempts"
            remedy = "mend the expert or raise --collection.attempts"
            raise UserError(f"{found}; {job.count} demonstrations were asked for; {remedy}")
        wave = list(itertools.islice(unknown, max(4, job.count - len(made))))
        made += _attempt(job, wave, recipe)
        attempts += len(wave)
    return made[: job.count]


def _attempt(job: Job, seeds: list[int], recipe: CollectionConfig) -> list[Trajectory]:
    domain = _domains[job.domain]
    tasks = [job.task] * len(seeds)
    demonstrator = Demonstrator(domain, recipe.noise, recipe.random_start_steps)
    episodes = rollout(domain.simulator, demonstrator.act, tasks, seeds, recipe.hold_steps, [demonstrator])
    solved = np.flatnonzero(episodes.success & (episodes.steps > recipe.random_start_steps))
    return [_trajectory(job, demonstrator, int(i)) for i in solved]


def _trajectory(job: Job, demonstrator: Demonstrator, index: int) -> Trajectory:
    seed = demonstrator.seeds[index]
    return Trajectory(job.domain, job.task, *demonstrator.episode(index), seed=seed, success=True)


class Demonstrator(Observer):
    """Lets an expert act, hears what comes of it, and writes down all that was seen and what the expert wanted.

    Args:
        domain: Who acts, and where.
        noise: Standard deviation of noise on the executed action.
        random_start_steps: Control steps before the expert takes over, in which each episode repeats a random action.
    """

    def __init__(self, domain: Domain, noise: float, random_start_steps: int = 0) -> None:
        assert domain.expert is not None
        self.simulator, self.expert = domain.simulator, domain.expert
        self.noise, self.random_start_steps = noise, random_start_steps

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        """Forget everything but how the episodes begin; seeds are also those of noise and random actions."""
        self.expert.begin(self.simulator, tasks, seeds)
        size = self.simulator.spec("").action_size
        drifts = [episode_generator(seed, EpisodeStream.RANDOM_START).uniform(-1, 1, size) for seed in seeds]
        self.seeds, self.drifts = seeds, np.array(drifts, dtype=np.float32)
        self.generators = [episode_generator(seed, EpisodeStream.ACTION_NOISE) for seed in seeds]
        self.drifting = self.random_start_steps
        self.seen = [(np.arange(len(tasks)), observation)]
        self.wanted: list[tuple[np.ndarray, np.ndarray]] = []

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        """The expert's actions, with noise if asked for; before it takes over, the episodes' own random ones."""
        if self.drifting > 0:
            drifting: np.ndarray = self.drifts[episodes]
            return drifting
        actions = np.clip(self.expert.act(observation, episodes), -1, 1).astype(np.float32)
        self.wanted.append((episodes, actions))
        if self.noise == 0:
            return actions
        shaken = [self.generators[e].normal(0, self.noise, actions.shape[1]) for e in episodes]
        noisy: np.ndarray = np.clip(actions + np.array(shaken, dtype=np.float32), -1, 1)
        return noisy

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        """Write down what the episodes show now; while they drift, only that."""
        if self.drifting > 0:
            self.drifting -= 1
            self.seen.clear()
        self.seen.append((episodes, step.observation))

    def episode(self, index: int) -> tuple[Observation[np.ndarray], np.ndarray]:
        """Observations ``(T + 1, …)``, the last after the last action, and actions ``(T, A)`` of one episode."""
        seen = [observation.take(i) for episodes, observation in self.seen for i in np.flatnonzero(episodes == index)]
        actions = [wanted[episodes == index] for episodes, wanted in self.wanted]
        images = [observation.image for observation in seen if observation.image is not None]
        states = np.stack([observation.state for observation in seen])
        return Observation(states, np.stack(images) if images else None), np.concatenate(actions)
