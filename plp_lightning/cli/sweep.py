"""``plp sweep``: from one run to a thousand."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from datamodules.errors import ConfigError, UserError
from plp_lightning.cli.config import find_page
from plp_lightning.cli.options import OptionParser, not_negative, positive
from plp_lightning.cli.planning import choose, plan, read_page
from plp_lightning.sweeps.local import Engine, LocalEngine, places
from plp_lightning.sweeps.manifest import Job, write_manifest
from plp_lightning.sweeps.sharing import jobs_of
from plp_lightning.sweeps.slurm import SlurmEngine, check_slurm
from plp_lightning.sweeps.table import SweepProgress


def run_sweep(arguments: Sequence[str]) -> None:
    """``plp sweep --config PAGE``: every run of a page that is not done yet."""
    options, flags = _options().parse_known_args(list(arguments))
    if len(options.config) > 1:
        raise ConfigError(f"--config is given {len(options.config)} times; expected one page of a sweep: name one")
    page = find_page(options.config[0])
    parts = read_page(page, options.root)
    if not parts[0].root:
        raise ConfigError("root is empty; expected a folder for run directories: name one or leave it away")
    root = Path(parts[0].root)
    runs = plan(parts, flags, page.stem)
    jobs = jobs_of(choose(runs, options.only), root, runs)
    if options.dry_run:
        print(_counts(jobs))
    elif options.print:
        print("\n".join(shlex.join(["plp", *job.next_words()]) for job in jobs if job.state() != "done"))
    else:
        work = _local(jobs, options) if options.engine == "local" else _slurm(jobs, root, options)
        with _locked(root):
            write_manifest(root / f"{page.stem}.jsonl", jobs)
            _work(jobs, root, work)


def _local(jobs: Sequence[Job], options: argparse.Namespace) -> Engine:
    return LocalEngine(jobs, places(options.jobs, options.per_gpu), options.retries)


def _slurm(jobs: Sequence[Job], root: Path, options: argparse.Namespace) -> Engine:
    check_slurm()
    return SlurmEngine(jobs, root / ".slurm", _passed_on(options.slurm), options.per_job, options.retries)


def _work(jobs: Sequence[Job], root: Path, engine: Engine) -> None:
    """Run all jobs; a :class:`UserError` says how many are not done."""
    with SweepProgress(jobs, engine.at_a_time) as progress:
        engine.run(progress)
    print(f"{progress.summary()}; runs are in {root}", file=sys.stderr)
    if lost := [name for name, state in progress.states.items() if state != "done"]:
        found = f"{len(lost)} of {len(jobs)} are not done, the first is {lost[0]}: {progress.reasons[lost[0]]}"
        raise UserError(f"{found}; mend what it says, then go on with the same command")


def _counts(jobs: Sequence[Job]) -> str:
    """Lines that say what a sweep comes to."""
    runs = [job for job in jobs if job.directory is not None]
    states = Counter(job.state() for job in runs)
    lines = [f"{len(runs)} runs: {states['done']} done, {states['begun']} begun, {states['new']} to begin"]
    lines += [
        f"{job.name}: {'complete' if job.state() == 'done' else 'first'}" for job in jobs if job.directory is None
    ]
    return "\n".join([*lines, *(f"{job.name}: {job.begins_with}" for job in runs if job.begins_with)])


def _passed_on(words: Sequence[str]) -> dict[str, str | int]:
    pairs = [word.partition("=") for word in words]
    if wrong := next((word for word, pair in zip(words, pairs, strict=True) if not all(pair)), None):
        raise ConfigError(f"--slurm {wrong}: expected NAME=VALUE, such as partition=gpu time=240 mem=8G")
    return {name: int(value) if value.isdecimal() else value for name, _, value in pairs}


@contextmanager
def _locked(root: Path) -> Iterator[None]:
    """Keep other sweeps out of a root, for as long as this process lives."""
    root.mkdir(parents=True, exist_ok=True)
    try:
        lock = FileLock(root / ".sweep.lock", timeout=0).acquire()
    except Timeout:
        raise ConfigError(f"{root}: another sweep works here; wait for it, stop it, or name another --root") from None
    with lock:
        yield


def _options() -> OptionParser:
    description = "All runs of a page: experiments × methods × target tasks × seeds × overrides. Further options are"
    description += " those of plp fit, and go to every run."
    parser = OptionParser("plp sweep", description=description, allow_abbrev=False)
    parser.add_argument(
        "--config", required=True, action="append", metavar="PAGE", help="page of the sweep, such as sweeps/smoke"
    )
    parser.add_argument("--root", help="folder of the run directories, in place of the page's")
    parser.add_argument("--only", default="*", metavar="GLOB", help="runs of these names alone: 'r2r/plp/*/seed_0'")
    parser.add_argument("--dry_run", action="store_true", help="count: what is done, what is shared; run nothing")
    parser.add_argument("--print", action="store_true", help="print what is left as lines for a shell; run nothing")
    parser.add_argument("--retries", type=not_negative, default=1, help="further attempts of what fails (default: 1)")
    parser.add_argument("--engine", choices=("local", "slurm"), default="local", help="where runs are (default: local)")
    parser.add_argument("--jobs", type=positive, help="local: runs at a time; as many as cores if not given")
    parser.add_argument("--per_gpu", type=positive, help="local: runs at a time on each GPU; 1 if not given")
    parser.add_argument("--per_job", type=positive, default=1, help="slurm: runs side by side in a job (default: 1)")
    told = "slurm: options of submitit, such as partition=gpu time=240 mem=8G"
    parser.add_argument("--slurm", nargs="+", default=[], metavar="NAME=VALUE", help=told)
    return parser
