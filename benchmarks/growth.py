"""Growth of a training step with batch, domains, tasks and lengths of trajectories.

Each row compares a size with the next smaller one: a ratio of steps, divided by the ratio of sizes, is 1 where the
cost grows as the size does. MMD's matrix of pairs grows with the square, so that it has rows of its own without a bar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from benchmarks.measuring import Bar, Options, Row, Way, at_most, in_turn
from benchmarks.synthetic import random_data
from benchmarks.training import fit
from datamodules.amounts import Batching
from datamodules.transfer import TransferDataModule
from plp_lightning.methods.plp import Alignment
from plp_lightning.methods.plp.policy import PortablePolicy
from plp_lightning.methods.plp.terms import MMD, TCC, TermFactory

CLONING: dict[str, TermFactory] = {}
PAIRWISE: dict[str, TermFactory] = {"mmd": MMD}
LINEAR = at_most(1.0)
STEPS = 30


def step(data: TransferDataModule, folder: Path, terms: Mapping[str, TermFactory], steps: int) -> Way:
    """The way that gives seconds of a step of alignment with these terms."""
    return lambda: fit(Alignment(PortablePolicy(data.problem), terms), data, folder, steps)


def grown(
    name: str,
    sizes: Sequence[int],
    data: Callable[[Path, int], TransferDataModule],
    terms: Mapping[str, TermFactory],
    bar: Bar | None,
    options: Options,
) -> Iterator[Row]:
    """Rows of neighbouring sizes, whose steps are taken in turn; matrices of pairs have to do with few."""
    steps = STEPS if bar else STEPS // 3
    with TemporaryDirectory() as place:
        folders = {size: Path(place) / str(size) for size in sizes}
        for folder in folders.values():
            folder.mkdir()
        ways = {str(size): step(data(folder, size), folder, terms, steps) for size, folder in folders.items()}
        times = in_turn(ways, options.pick(5 if bar else 2, 1))
    for small, large in pairwise(sizes):
        values = [b / a * small / large for a, b in zip(times[str(small)], times[str(large)], strict=True)]
        seconds = {str(size): median(times[str(size)]) for size in (large, small)}
        yield Row(f"{name} {small} → {large}: growth of a step / of that", values, "×", bar, seconds)


def batch(options: Options) -> Iterator[Row]:
    sizes = [64, 256, 1024, 4096]
    for told, terms, bar in (("cloning", CLONING, LINEAR), ("with MMD", PAIRWISE, None)):
        made = lambda folder, size: random_data(folder, size, steps=STEPS, tasks=9)  # noqa: E731
        yield from grown(f"batch, {told},", sizes, made, terms, bar, options)


def domains(options: Options) -> Iterator[Row]:
    """Batches grow with the domains: 128 steps of each."""
    for told, terms, bar in (("cloning", CLONING, LINEAR), ("with MMD", PAIRWISE, None)):
        made = lambda folder, count: random_data(folder, 128 * count, steps=STEPS, domains=count, tasks=9)  # noqa: E731
        yield from grown(f"domains, {told},", [2, 4, 8], made, terms, bar, options)


def tasks(options: Options) -> Iterator[Row]:
    made = lambda folder, count: random_data(folder, 256, steps=STEPS, tasks=count, length=20)  # noqa: E731
    yield from grown("tasks, with MMD,", [16, 128, 1024], made, PAIRWISE, LINEAR, options)


def length(options: Options) -> Iterator[Row]:
    """Frames of TCC's pairs grow with the trajectories."""

    def made(folder: Path, steps: int) -> TransferDataModule:
        chosen = Batching(batch_size=256, tasks_per_batch=None, epoch_steps=STEPS, pairs=32, stride=16)
        return random_data(folder, 256, steps=STEPS, tasks=9, length=steps, batching=chosen)

    yield from grown("length, with TCC,", [50, 200, 800], made, {"tcc": TCC}, LINEAR, options)
