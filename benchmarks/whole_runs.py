"""Whole runs of P2P-medium: one alone, and what 27 of them, three goals by nine seeds, take on one GPU and all cores.

Their demonstrations are collected first, on the processor, and count for nothing.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measuring import Options, Row
from plp_lightning.envs.cores import available_cores

ROOT = Path(__file__).parents[1]
GOALS, SEEDS = ("goal_1_6", "goal_6_1", "goal_6_6"), 9
SHARES = (0.05, 0.1)
"""Shares of their epochs that runs side by side train; two tell what training takes and what the rest does."""
LITTLE = (
    *("--data.trajectories", "107", "--data.target_trajectories", "10", "--trainer.max_epochs", "1"),
    *("--evaluation.final_episodes", "4", "--evaluation.latent_states", "0"),
)
"""What tries this without a GPU."""


class Runs:
    """Processes of ``plp fit`` on P2P-medium, in a folder of their own."""

    def __init__(self, folder: str, options: Options) -> None:
        accelerator = "gpu" if options.device == "cuda" else "cpu"
        little = LITTLE if options.short or options.device == "cpu" else ()
        self.folder, self.options = folder, ["--data.root", folder, "--config", "configs/p2p_medium.yaml", *little[:4]]
        self.fit = [*little[4:], "--cuda_graphs", "true", "--trainer.accelerator", accelerator]

    def collect(self, goals: Sequence[str]) -> None:
        """Collect the demonstrations that runs with these goals need."""
        for goal in goals:
            self._wait([self._start("collect", "--data.target_task", goal)])

    def side_by_side(self, count: int, words: Sequence[str] = ()) -> float:
        """Seconds that so many runs take together."""
        began, chosen = time.perf_counter(), [(goal, seed) for seed in range(SEEDS) for goal in GOALS][:count]
        place = ["--run_root", f"{self.folder}/{began}"]
        named = [["--data.target_task", goal, "--seed", str(seed)] for goal, seed in chosen]
        self._wait([self._start("fit", *self.fit, *place, *name, *words) for name in named])
        return time.perf_counter() - began

    def _start(self, verb: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "plp_lightning", verb, *self.options, *words]
        return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)

    def _wait(self, processes: Sequence[subprocess.Popen[bytes]]) -> None:
        codes = [process.wait() for process in processes]
        if any(codes):
            raise RuntimeError(f"plp left with {codes}; its complaint is above")


def whole(options: Options) -> Iterator[Row]:
    """Seconds of one run, from the command to its table."""
    with TemporaryDirectory() as folder:
        runs = Runs(folder, options)
        runs.collect(GOALS[:1])
        words = share(SHARES[0]) if options.device == "cpu" else ()
        told = "a twentieth of an epoch, few demonstrations: not on a GPU" if words else ""
        yield Row("p2p_medium, a whole run", [runs.side_by_side(1, words)], "s", options.on_gpu(60.0), note=told)


def many(options: Options) -> Iterator[Row]:
    """Seconds of 27 runs, a core each, from two short trainings of as many as there are cores."""
    count = min(available_cores(), len(GOALS) * SEEDS)
    with TemporaryDirectory() as folder:
        runs = Runs(folder, options)
        runs.collect(GOALS)
        few, more = (runs.side_by_side(count, share(part)) for part in SHARES)
    rounds, training = len(GOALS) * SEEDS / count, (more - few) / (SHARES[1] - SHARES[0])
    rest = few - training * SHARES[0]
    told = f"{count} at a time: training {training:.0f} s, the rest {rest:.0f} s; worked out from parts of each epoch"
    yield Row("p2p_medium, 27 runs side by side", [rounds * (training + rest)], "s", options.on_gpu(600.0), note=told)


def share(part: float) -> list[str]:
    """Words for such a part of each epoch."""
    return ["--trainer.limit_train_batches", str(part)]
