"""The memory of a fit that reads its images from disk, for files of growing size: it should stay flat.

Each fit is a process of its own; MB are the most that it ever held, beyond what it held before it opened the file.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measuring import Options, Row, at_most
from benchmarks.phase_steps import Case, Steps, experiment_of

ONDISK = ("--data.image_memory", "0.01")  # GiB, so that images stay in the file
CASE = Case(("v2v_reach.yaml",), "alignment", ONDISK, length=40)
UNIT = 1e3 if sys.platform == "linux" else 1e6  # of what the system tells


def most() -> float:
    """MB that this process held at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT


def written(case: Case, folder: Path) -> float:
    """MB of a new file of random demonstrations."""
    folder.mkdir()
    return Path(experiment_of(case, folder).data.path).stat().st_size / 1e6


def fitted(case: Case, folder: Path, steps: int) -> float:
    """MB that some steps of a fit take."""
    steps_of = Steps(case, folder, "cpu", steps)
    before = most()
    steps_of.fitted(False, steps, epochs=1)
    return most() - before


def rows(options: Options) -> Iterator[Row]:
    found, context = list[tuple[float, float]](), multiprocessing.get_context("fork")
    with TemporaryDirectory() as place, context.Pool(1, maxtasksperchild=1) as pool:
        for count in (8, 64):
            of = CASE._replace(per_task=count), Path(place) / str(count)
            found.append((pool.apply(written, of), pool.apply(fitted, (*of, options.pick(20, 5)))))
    (small, least), (large, greatest) = found
    told = ", ".join(f"{memory:.0f} MB for a file of {size:.0f} MB" for size, memory in found)
    growth = [(greatest - least) / (large - small)]
    yield Row("fit from disk: MB of memory for each MB of file", growth, "", at_most(0.1), note=told)
