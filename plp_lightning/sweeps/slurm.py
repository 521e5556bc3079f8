"""The SLURM engine: arrays of jobs through submitit, requeued when they are preempted or run out of time."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from datamodules.errors import ConfigError, UserError
from datamodules.store.atomic import write_atomically
from plp_lightning.sweeps.local import Engine, LocalEngine, places_side_by_side
from plp_lightning.sweeps.manifest import Job, stages
from plp_lightning.sweeps.processes import last_words
from plp_lightning.sweeps.table import SweepProgress

TICK = 3.0  # s between two looks at the queue
MOST_TIMEOUTS = 100  # Requeues of a job whose time is over: it goes on where it was
DEFAULTS: Mapping[str, str | int] = {"job_name": "plp-sweep", "time": 240, "stderr_to_stdout": True}
SIGNAL = "SUBMITIT_PREEMPT_SIGNAL"


def check_slurm() -> None:
    """Refuse, by a :class:`ConfigError`, a machine without submitit or without SLURM's commands."""
    if find_spec("submitit") is None:
        told = "--engine slurm needs submitit, which is not installed"
        raise ConfigError(f"{told}; install the extra 'cluster' with: pip install -e '.[cluster]'")
    for command in ("sbatch", "srun", "squeue"):
        if shutil.which(command) is None:
            told = f"--engine slurm needs {command}, which is not here"
            raise ConfigError(f"{told}; expected a machine that submits jobs to SLURM: go there, or leave it away")


@dataclass
class Pack:
    """Jobs that one job of SLURM works on, side by side."""

    jobs: list[Job]

    def __call__(self) -> None:
        """Begin the jobs, or go on with them.

        Raises:
            UserError: If one fails.
        """
        with SweepProgress(self.jobs, len(self.jobs)) as progress:
            self.engine = LocalEngine(self.jobs, places_side_by_side(len(self.jobs)), 0)
            self.engine.run(progress)
        if failed := [name for name, state in progress.states.items() if state != "done"]:
            raise UserError(f"{failed[0]}: {progress.reasons[failed[0]]}")

    def checkpoint(self) -> Any:
        """Let all processes save; submitit asks for it before it requeues the job."""
        self.engine.stop()
        return importlib.import_module("submitit").helpers.DelayedSubmission(Pack(self.jobs))


class SlurmEngine(Engine):
    """Submits jobs, waits until none is queued, and submits those that failed again.

    Jobs outlive this process; the next one waits for those that are queued still.

    Args:
        jobs: The jobs.
        folder: Folder of submitit's files.
        options: Parameters of submitit's executor by name, such as partition, time (min) and mem.
        per_job: Runs in a job of SLURM.
        retries: Further attempts of a job that fails.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        folder: Path,
        options: Mapping[str, str | int],
        per_job: int,
        retries: int,
    ) -> None:
        self.jobs, self.folder, self.per_job = list(jobs), folder.absolute(), per_job
        self.options = {**DEFAULTS, "cpus_per_task": per_job, **options}
        self.retries, self.at_a_time = retries, len(jobs)
        self.queued = self.folder / "queued.json"
        self.collections = dict[str, Any]()  # submitit's jobs, by the name of a collection

    def run(self, progress: SweepProgress) -> None:
        self.progress = progress
        self._wait()  # for those of an earlier sweep
        for attempt in range(self.retries + 1):
            self._submit()
            self._wait()
            self._judge(last=attempt == self.retries)

    def _open(self) -> list[Job]:
        return [job for job in self.jobs if self.progress.states[job.name] not in ("done", "failed")]

    def _submit(self) -> None:
        before: list[str] = []
        for stage in stages(self._open()):
            after = {"dependency": f"afterany:{':'.join(before)}"} if before else {}
            packs = [stage[i : i + self.per_job] for i in range(0, len(stage), self.per_job)]
            before = self._submit_array([[replace(job, after={}) for job in pack] for pack in packs], after)

    def _submit_array(self, packs: Sequence[list[Job]], after: Mapping[str, str]) -> list[str]:
        executor = self._executor({**self.options, **after})
        with executor.batch():
            submitted = [executor.submit(Pack(pack)) for pack in packs]
        ids = list(dict.fromkeys(str(job.job_id).partition("_")[0] for job in submitted))
        for pack, handle in zip(packs, submitted, strict=True):
            self.collections |= {job.name: handle for job in pack if job.directory is None}
        write_atomically(self.queued, json.dumps([*self._ids(), *ids]))
        return ids

    def _executor(self, options: Mapping[str, str | int]) -> Any:
        os.environ.setdefault(SIGNAL, "USR1")  # which plp fit takes as a request to save
        submitit = importlib.import_module("submitit")
        self.folder.mkdir(parents=True, exist_ok=True)
        executor = submitit.SlurmExecutor(self.folder, max_num_timeout=MOST_TIMEOUTS)
        if unknown := [name for name in options if name not in executor._valid_parameters()]:
            known = ", ".join(sorted(executor._valid_parameters()))
            raise ConfigError(f"--slurm: unknown option {unknown[0]!r}; expected some of {known}")
        executor.update_parameters(**options)
        return executor

    def _ids(self) -> list[str]:
        """Numbers of SLURM's jobs that were submitted and may be queued still."""
        with contextlib.suppress(OSError, ValueError):
            return [str(number) for number in json.loads(self.queued.read_text())]
        return []

    def _wait(self) -> None:
        try:
            while any(number in _in_queue() for number in self._ids()):
                self._look()
                time.sleep(TICK)
        except BaseException:
            print(f"jobs stay in the queue of SLURM; to end them: scancel {' '.join(self._ids())}", flush=True)
            raise
        self.queued.unlink(missing_ok=True)
        self._look()

    def _look(self) -> None:
        for job in self._open():
            state = self._state(job)
            if state != self.progress.states[job.name]:
                self.progress.set(job.name, state)
        self.progress.refresh()

    def _state(self, job: Job) -> str:
        if job.directory is None:
            handle = self.collections.get(job.name)
            if handle is None or not handle.paths.result_pickle.exists():
                return "waiting"
            return "done" if handle.exception() is None else "waiting"
        run = job.run
        if job.state() == "done":
            return "done"
        return "running" if run is not None and run.status()["state"] == "running" else "waiting"

    def _judge(self, last: bool) -> None:
        for job in self._open():
            reason = last_words(Path(job.log))
            self.progress.set(job.name, "failed" if last else "waiting", f"{reason}; its log: {job.log}")


def _in_queue() -> set[str]:
    """Numbers of this user's jobs; those of arrays have one."""
    while True:
        asked = subprocess.run(["squeue", "--me", "-h", "-o", "%F"], capture_output=True, text=True, check=False)
        if asked.returncode == 0:
            return {*asked.stdout.split()}
        time.sleep(TICK)  # a controller that is busy or starts again
