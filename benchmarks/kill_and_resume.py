"""Kill runs at random moments, with SIGKILL, resume them, and compare bit by bit what they and an unbroken run leave.

    python benchmarks/kill_and_resume.py [KILLS] [--seed N] [--methods plp gama …]

Every run is ``plp fit`` on the smoke page in miniature, in a process of its own; each second one begins without
demonstrations, so that collecting is killed too. A run is killed up to three times before it may finish. Weights,
optimizers, curves, results and demonstrations have to be those of the unbroken run, and no process may be left.
"""

from __future__ import annotations

import argparse
import functools
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT)]
sys.path.append(str(ROOT / "tests"))

from command import METHODS, SMOKE, TINY, checkpoint, processes, results, same, smoke_run  # noqa: E402

from datamodules.store.reader import TrajectoryFile  # noqa: E402
from plp_lightning.cli.main import main  # noqa: E402
from plp_lightning.runs.directory import RunDirectory  # noqa: E402

PAGES = {page.stem: ["--config", str(page)] for page in METHODS}
STATES = ("state_dict", "optimizer_states", "lr_schedulers", "global_step", "epoch", "TransferDataModule")
LONGEST = 300.0  # Seconds after which a process hangs
GRACE = 10.0  # Seconds that workers have to notice that their parent is gone


class Run(NamedTuple):
    """A run below a folder of its own, with demonstrations of its own."""

    folder: Path
    method: str

    @property
    def directory(self) -> RunDirectory:
        return smoke_run(self.folder / "runs", self.method)

    @property
    def data(self) -> Path:
        return self.folder / "data" / "smoke.hdf5"

    def command(self) -> list[str]:
        """Words that begin the run, or go on with it."""
        if self.directory.config.exists():
            return ["fit", "--resume", str(self.directory.path)]
        places = ["--run_root", str(self.folder / "runs"), "--data.root", str(self.data.parent)]
        return ["fit", *SMOKE, *TINY, *PAGES[self.method], *places, "--collection.processes", "2"]


def execute(run: Run, kill_after: float = LONGEST) -> tuple[int | None, float]:
    """Go on with a run in a process that is killed after so many seconds; its exit code, and the seconds it took."""
    process, began = processes.Process(target=_plp, args=(run.command(),)), time.monotonic()
    process.start()
    process.join(kill_after)
    process.kill()
    process.join()
    taken, until = time.monotonic() - began, time.monotonic() + GRACE
    while _session(process.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert not _session(process.pid), f"processes are left: {_session(process.pid)}"
    return process.exitcode, taken


def _plp(words: list[str]) -> None:
    os.setsid()  # so that whoever is left behind can be found
    torch.set_num_threads(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    main(words)


def _session(number: int | None) -> list[int]:
    """Processes of a session that are alive."""
    stats = [path.read_text().rpartition(")")[2].split() for path in Path("/proc").glob("[0-9]*/stat") if path.exists()]
    return [int(fields[3]) for fields in stats if int(fields[3]) == number and fields[0] != "Z"]


def differences(run: Run, unbroken: Run) -> list[str]:
    """All in which two finished runs differ."""
    found = []
    for phase in unbroken.directory.status()["phases"]:
        for which in ("last", "best"):
            mine, other = (checkpoint(each.directory, phase, which) for each in (run, unbroken))
            found += [f"{phase}/{which}.ckpt: {name}" for name in STATES if not same(mine.get(name), other.get(name))]
        curves = [(each.directory.phase(phase) / "metrics.csv").read_text() for each in (run, unbroken)]
        found += [] if curves[0] == curves[1] else [f"{phase}/metrics.csv"]
    found += [] if results(run.directory) == results(unbroken.directory) else ["results.json"]
    return found if _hashes(run.data) == _hashes(unbroken.data) else [*found, "demonstrations"]


def _hashes(file: Path) -> dict[str, str]:
    with TrajectoryFile.open(file) as content:
        return dict(content.hashes)


@functools.cache
def unbroken(root: Path, method: str) -> tuple[Run, dict[bool, float]]:
    """An unbroken run, and the seconds that it takes with demonstrations (True) and without."""
    run, seconds = Run(root / f"unbroken_{method}", method), {}
    for with_data in (False, True):
        shutil.rmtree(run.folder / "runs", ignore_errors=True)
        code, seconds[with_data] = execute(run)
        assert code == 0, f"{method} ends with {code}"
    return run, seconds


def attempt(root: Path, method: str, with_data: bool, rng: random.Random) -> tuple[int, list[str]]:
    """Kills of one run, and all in which it differs in the end."""
    (other, seconds), run = unbroken(root, method), Run(Path(tempfile.mkdtemp(dir=root)), method)
    if with_data:
        shutil.copytree(other.data.parent, run.data.parent)
    kills, wanted, code = 0, rng.randint(1, 3), None
    while code != 0:
        moment = rng.uniform(0.1, seconds[with_data]) if kills < wanted else LONGEST
        code, _ = execute(run, moment)
        assert code in (0, -9), f"{run.directory.path}: exit code {code}; {run.command()}"
        kills += code == -9
    found = differences(run, other)
    if not found:
        shutil.rmtree(run.folder)
    return kills, found


def run_all(kills: int, methods: Sequence[str], seed: int) -> bool:
    """Kill until there were so many kills; tell of each run, and whether all came to the same end."""
    rng, root = random.Random(seed), Path(tempfile.mkdtemp(prefix="kills_"))
    done = same_end = runs = 0
    while done < kills:
        method = methods[runs % len(methods)]
        count, found = attempt(root, method, bool(runs % 2), rng)
        done, runs, same_end = done + count, runs + 1, same_end + (not found)
        print(f"{method}: {count} kills, {', '.join(found) or 'the same'}; {done} of {kills} kills", flush=True)
    print(f"{same_end} of {runs} runs, killed {done} times, came to the same end; what differs is in {root}")
    return same_end == runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kills", type=int, nargs="?", default=60)
    parser.add_argument("--methods", nargs="+", default=["plp", "plp_t_disc", "gama", "cdil", "contextual"])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.exit(not run_all(options.kills, options.methods, options.seed))
