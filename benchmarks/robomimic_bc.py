"""This project's BC beside robomimic's: the same perceptron on the same demonstrations, and both loaders.

robomimic lives in an environment of its own, whose Python ``--robomimic`` names. A process of it answers each line with
the seconds that its steps have taken, so that both projects take turns. Both count the processor's time of one thread.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, cast

import h5py
import numpy as np

from benchmarks.measuring import Options, Row, Way, at_most, in_turn, ratio, timed
from benchmarks.synthetic import random_data
from benchmarks.training import fit
from datamodules.errors import UserError
from datamodules.transfer import TransferDataModule
from datamodules.types import BatchSpec
from plp_lightning.methods.bc.phases import BCCloning
from plp_lightning.methods.bc.policy import BCPolicy

WORKER = Path(__file__).parent / "robomimic_worker.py"
BATCH, UNITS, LAYERS = 256, 192, 4
ALONE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}  # of an environment of its own
OURS, THEIRS = "plp", "robomimic"
NAMES = {
    "bc": f"BC of {LAYERS} × {UNITS} units, a step and its batch: {OURS} / {THEIRS}",
    "loader": f"batches of {BATCH} from memory: {OURS} / {THEIRS}'s SequenceDataset",
}


def rows(options: Options) -> Iterator[Row]:
    if options.robomimic is None:
        told = "name a Python that has robomimic, --robomimic PYTHON; docs/performance.md says how to make one"
        yield from (Row(name, note=told) for name in NAMES.values())
        return
    steps = options.pick(200, 50)
    with TemporaryDirectory() as place:
        data = random_data(Path(place), BATCH, steps, tasks=9)
        ours = {"bc": cloning(data, Path(place), steps), "loader": loading(data)}
        theirs = Robomimic(options.robomimic, exported(data, Path(place) / "robomimic.hdf5"), steps)
        for asked, name in NAMES.items():
            ways = {OURS: ours[asked], THEIRS: theirs.way(asked)}
            yield ratio(name, in_turn(ways, options.pick(9, 2)), OURS, THEIRS, at_most(1.0))
        theirs.end()


def cloning(data: TransferDataModule, folder: Path, steps: int) -> Way:
    """Seconds of a step of our cloning under the Trainer."""
    return lambda: fit(BCCloning(BCPolicy(data.problem, UNITS, LAYERS)), data, folder, steps)


def loading(data: TransferDataModule) -> Way:
    """Seconds of a batch of ours."""
    loader = data.loader(BatchSpec("proxy_tasks"))

    def epoch() -> None:
        for _ in loader:
            pass

    whole = timed(epoch, clock=time.process_time)
    return lambda: whole() / len(loader)


def exported(data: TransferDataModule, file: Path) -> Path:
    """The demonstrations as robomimic reads them; a state is all that our perceptron sees, one-hot task included."""
    widths, tasks = [spec.state_size for spec in data.specs], np.eye(len(data.tasks), dtype=np.float32)
    with h5py.File(file, "w") as opened:
        group = opened.create_group("data")
        for i, (domain, dataset) in enumerate(data.datasets.items()):
            before, after, identity = sum(widths[:i]), sum(widths[i + 1 :]), np.eye(len(widths), dtype=np.float32)[i]
            for episode in data.episodes(domain, data.proxy_tasks, "train"):
                part = slice(*dataset.offset[episode : episode + 2])
                state = np.pad(dataset.observation.state[part].numpy(), ((0, 0), (before, after)))
                told = np.tile(np.concatenate([identity, tasks[dataset.episode_task[episode]]]), (len(state), 1))
                demo = group.create_group(f"demo_{len(group)}")
                demo.attrs["num_samples"] = len(state)
                demo["obs/state"], demo["actions"] = np.concatenate([state, told], axis=1), dataset.action[part].numpy()
    return file


class Robomimic:
    """A process of robomimic's own Python.

    Raises:
        UserError: If it does not come up.
    """

    def __init__(self, python: str, file: Path, steps: int) -> None:
        words = [python, str(WORKER), str(file), *map(str, (steps, BATCH, UNITS, LAYERS))]
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        self.process = subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=nowhere, text=True, env=ALONE)
        self.asked, self.answers = cast("IO[str]", self.process.stdin), cast("IO[str]", self.process.stdout)
        if self.answers.readline().strip() != "ready":
            raise UserError(f"{python}: does not run {WORKER}; expected a Python that has robomimic, torch and h5py")

    def way(self, what: str) -> Way:
        """The way that asks for ``bc`` or ``loader``."""

        def seconds() -> float:
            print(what, file=self.asked, flush=True)
            return float(self.answers.readline())

        return seconds

    def end(self) -> None:
        """Let it go."""
        self.asked.close()
        self.process.wait()
