"""The local engine: as many processes at a time as there are places, each in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence

from datamodules.errors import ConfigError
from plp_lightning.envs.cores import PROCESSES, available_processes
from plp_lightning.sweeps.gpu_memory import GpuMemory
from plp_lightning.sweeps.manifest import Job, unmet
from plp_lightning.sweeps.memory import free_bytes, peak_bytes
from plp_lightning.sweeps.processes import JobProcess, last_words, stop
from plp_lightning.sweeps.table import SweepProgress

TICK = 0.2  # s between two looks at the processes
VISIBLE = "CUDA_VISIBLE_DEVICES"


class Engine(ABC):
    """Works on jobs."""

    at_a_time: int  # Jobs that it works on at a time, as far as that is known

    @abstractmethod
    def run(self, progress: SweepProgress) -> None:
        """Work until every job is done, has failed, or waits for one that has; ``progress`` hears of all of it."""


class LocalEngine(Engine):
    """Runs jobs in processes of this machine.

    They end with this process, whatever ends it. Whatever is raised in :meth:`run`, such as a signal, stops them first.

    Args:
        jobs: The jobs.
        places: Variables of the environment of each place; one job runs in a place at a time.
        retries: Further attempts of a job that fails.
    """

    def __init__(self, jobs: Sequence[Job], places: Sequence[Mapping[str, str]], retries: int) -> None:
        self.jobs, self.retries = {job.name: job for job in jobs}, retries
        self.free, self.running = list(places), list[tuple[JobProcess, Mapping[str, str]]]()
        self.at_a_time, self.attempts = len(places), Counter[str]()
        self.largest = 0  # Bytes that the largest run so far has taken, with its own processes
        self.gpu_memory = GpuMemory()

    @property
    def waiting(self) -> list[Job]:
        """Jobs that have not begun, in order."""
        return [job for name, job in self.jobs.items() if self.progress.states[name] == "waiting"]

    def run(self, progress: SweepProgress) -> None:
        self.progress = progress
        try:
            while self.waiting or self.running:
                self._end_what_is_over()
                self._begin_what_may()
                self.progress.refresh()
                time.sleep(TICK)
        finally:
            self.stop()

    def stop(self) -> None:
        """Let all processes save and leave."""
        stop([process for process, _ in self.running])

    def _end_what_is_over(self) -> None:
        for process, place in [*self.running]:
            self.largest = max(self.largest, peak_bytes(process.process.pid))
            if process.process.poll() is not None:
                self.running.remove((process, place))
                self.free.append(place)
                self._judge(process)

    def _judge(self, process: JobProcess) -> None:
        name, code = process.job.name, process.process.returncode
        self.attempts[name] += 1
        if code == 0:
            self.progress.set(name, "done")
        else:
            state = "waiting" if self.attempts[name] <= self.retries else "failed"
            self.progress.set(name, state, f"exit code {code}, {last_words(process.log)}; its log: {process.log}")

    def _begin_what_may(self) -> None:
        if not self.waiting or self._place() is None:
            return
        ready = self._ready()
        side_by_side = max(1, min(self.at_a_time, len(self.running) + len(ready)))
        share = {PROCESSES: str(max(1, available_processes() // side_by_side))}
        for job in ready:
            if (place := self._place()) is None:
                break
            self._begin(job, share, place)

    def _ready(self) -> list[Job]:
        """Waiting jobs that lack nothing; those that wait for a lost one are told as blocked."""
        ready, phases = [], dict[str, list[str]]()  # Phases as they are now
        for job in self.waiting:
            lacking = unmet(job, self.jobs, self.progress.states, phases)
            if not lacking:
                ready.append(job)
            elif lost := [name for name in lacking if self.progress.states[name] in ("failed", "blocked")]:
                self.progress.set(job.name, "blocked", f"{lost[0]} is not done")
        return ready

    def _place(self) -> Mapping[str, str] | None:
        """A place that is free, with memory for one more run beside those that are there; None if there is none."""
        if self.running and free_bytes() < self.largest:
            return None
        return next((place for place in self.free if VISIBLE not in place or self._has_room(place[VISIBLE])), None)

    def _has_room(self, gpu: str) -> bool:
        there = [process.process.pid for process, place in self.running if place.get(VISIBLE) == gpu]
        return not there or self.gpu_memory.has_room(gpu.strip(), there)

    def _begin(self, job: Job, share: Mapping[str, str], place: Mapping[str, str]) -> None:
        self.free.remove(place)
        self.running.append((JobProcess(job, {**share, **place}), place))
        self.progress.set(job.name, "running")


def places(jobs: int | None, per_gpu: int | None) -> list[dict[str, str]]:
    """Places for jobs: so many for each GPU that may be used, or one for each core where there is none.

    Args:
        jobs: Most places; as many as there are if not given.
        per_gpu: Places for each GPU; 1 if not given.

    Raises:
        ConfigError: If ``per_gpu`` is given and there is no GPU.
    """
    found = _gpus()
    if per_gpu is not None and not found:
        raise ConfigError("--per_gpu: no GPU is to be seen here; expected one that nvidia-smi lists: leave it away")
    shared = [{VISIBLE: gpu} for _ in range(per_gpu or 1) for gpu in found]
    every = shared or [dict[str, str]() for _ in range(jobs or len(os.sched_getaffinity(0)))]
    return every[:jobs]


def places_side_by_side(count: int) -> list[dict[str, str]]:
    """So many places on what this process may use, GPUs taken in turns."""
    return places(count, count if _gpus() else None)


def _gpus() -> list[str]:
    """Names of the GPUs that this process may use, as CUDA_VISIBLE_DEVICES has them."""
    if VISIBLE in os.environ:
        return [name for name in os.environ[VISIBLE].split(",") if name.strip() not in ("", "-1")]
    try:
        listed = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=60, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return []
    return [str(i) for i, line in enumerate(listed.splitlines()) if line.startswith("GPU ")]
