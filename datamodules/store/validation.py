"""The checks behind ``plp data validate``: all that is wrong, odd or worth knowing about a trajectory file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.store.reader import DomainArrays, TrajectoryFile
from datamodules.types import DomainSpec


@dataclass(frozen=True)
class Finding:
    """One thing that a check found."""

    severity: Literal["info", "warning", "error"]
    """An error makes the file unfit for training; a warning asks for a look."""
    place: str  # Domain, task, key or path in the file
    message: str


def validate_file(path: Path | str) -> list[Finding]:
    """Read a whole trajectory file: errors first, then warnings, then the lengths of every (domain, task) pair."""
    path = Path(path).absolute()
    findings: list[Finding] = []
    try:
        with TrajectoryFile.open(path) as file:
            findings.extend(_findings(file))  # one by one: those found before a read fails are kept
    except TrajectoryFileError as error:
        findings.append(Finding("error", str(path), str(error).removeprefix(f"{path}: ")))
    return sorted(findings, key=lambda finding: ("error", "warning", "info").index(finding.severity))


def _findings(file: TrajectoryFile) -> Iterator[Finding]:
    for place in file.damaged():
        yield Finding("error", place, "values do not match their hash: copy or collect the file again")
    yield from _missing_tasks(file)
    for spec in file.domains:
        arrays = file.read(spec.name, images=False)
        yield from _values(spec, arrays)
        yield from _seeds(file, spec.name)
        for task in file.tasks:
            if (arrays.task == task).any():
                yield from _pair(file, spec.name, task, arrays)


def _missing_tasks(file: TrajectoryFile) -> Iterator[Finding]:
    counts = file.counts()
    for task in file.tasks:
        having = [domain for domain in counts if counts[domain][task]]
        for domain in counts:
            if having and domain not in having:
                message = f"no demonstration here, but in {', '.join(having)}: it cannot align the two"
                yield Finding("warning", f"{domain}, {task}", message)


def _values(spec: DomainSpec, arrays: DomainArrays) -> Iterator[Finding]:
    for key in spec.state_keys:
        values = arrays.state[:, spec.columns([key.name])]
        yield from _not_finite(f"{spec.name}, {key.name}", values, arrays)
        constant = np.flatnonzero((values == values[:1]).all(axis=0))
        if len(values) > 1 and len(constant):
            message = f"columns {constant.tolist()} never change: they cannot be normalised by their spread"
            yield Finding("warning", f"{spec.name}, {key.name}", message)
    yield from _not_finite(f"{spec.name}, actions", arrays.actions, arrays)
    outside = np.flatnonzero((np.abs(arrays.actions) > 1).any(axis=1))
    if len(outside):
        message = f"{len(outside)} steps outside [-1, 1], first in {_step(outside[0], arrays)}"
        yield Finding("error", f"{spec.name}, actions", message)


def _not_finite(place: str, values: np.ndarray, arrays: DomainArrays) -> Iterator[Finding]:
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        yield Finding("error", place, f"{len(bad)} steps are not finite, first in {_step(bad[0], arrays)}")


def _step(row: int, arrays: DomainArrays) -> str:
    if row >= arrays.offset[-1]:
        return f"episode {np.flatnonzero(arrays.last == row)[0]}, after its last step"
    episode = int(np.searchsorted(arrays.offset, row, side="right")) - 1
    return f"episode {episode}, step {row - arrays.offset[episode]}"


def _seeds(file: TrajectoryFile, domain: str) -> Iterator[Finding]:
    table = file.episodes(domain)
    pairs, counts = np.unique(np.stack([table.task, table.seed.astype(np.str_)]), axis=1, return_counts=True)
    for task, seed in pairs[:, counts > 1].T[:1]:
        message = f"{(counts > 1).sum()} seeds are used more than once, first {seed}: are these copies?"
        yield Finding("warning", f"{domain}, {task}", message)


def _pair(file: TrajectoryFile, domain: str, task: str, arrays: DomainArrays) -> Iterator[Finding]:
    place, episodes = f"{domain}, {task}", np.flatnonzero(arrays.task == task)
    lengths = np.diff(arrays.offset)[episodes]
    yield Finding("info", place, f"{len(episodes)} demonstrations of {lengths.min()} to {lengths.max()} steps")
    unknown = int((arrays.last[episodes] < 0).sum())
    if unknown:
        message = "end without a last observation: phases that look a step ahead leave their last steps out"
        yield Finding("info", place, f"{unknown} of {len(episodes)} demonstrations {message}")
    failed = int((~file.episodes(domain).success[episodes]).sum())
    if failed:
        yield Finding("warning", place, f"{failed} of {len(episodes)} demonstrations did not succeed")
    single = int((lengths == 1).sum())
    if single:
        yield Finding("warning", place, f"{single} demonstrations are one step long: nothing to align in time")
    if not file.spec(domain).state_keys:
        return
    states = (arrays.state[arrays.offset[e] : arrays.offset[e + 1]] for e in episodes)
    returning = sum(len(np.unique(state, axis=0)) < len(state) for state in states)
    if returning:
        message = f"{returning} of {len(episodes)} demonstrations visit a state twice: TCC cannot tell the visits apart"
        yield Finding("warning", place, message)
