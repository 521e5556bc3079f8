"""The importer of all formats: demonstrations of other projects → a trajectory file of ours."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from datamodules.formats import describe_sources
from datamodules.formats.limits import choose_limits, scale
from datamodules.formats.mapping import ImportOptions, select
from datamodules.formats.reading import Read, check_same, read_sources, understood
from datamodules.formats.source import Format, Source, SourceDescription, refuse_source
from datamodules.store.reader import TrajectoryFile
from datamodules.store.writer import add_trajectories
from datamodules.types import DomainSpec, Observation, Trajectory


@dataclass(frozen=True)
class Imported:
    """Outcome of an import."""

    spec: DomainSpec
    demonstrations: int
    steps: int
    tasks: Mapping[str, int]  # Number of demonstrations by task
    dropped: Mapping[str, str]  # What was left out, and why
    warnings: Sequence[str]
    limits: str  # Who told the limits of the actions


def import_demonstrations(
    form: Format, paths: Sequence[Path], options: ImportOptions, out: Path, record: Mapping[str, Any]
) -> Imported:
    """Add demonstrations of other projects to a trajectory file of ours, which may be new.

    Vectors are held in memory, images are read one episode at a time while our file is written.

    Args:
        form: Their format.
        paths: Files or folders, of one domain all.
        options: What becomes of keys, tasks, actions and images.
        out: Our file; one that exists grows.
        record: What provenance shall hold beside the source: command, versions.

    Raises:
        TrajectoryFileError: If a source is missing, damaged, hostile or not as it says, or ``out`` cannot be written.
        ConfigError: If the options do not fit the sources.
    """
    with ExitStack() as opened:
        sources = [_opened(form, path, opened) for path in paths]
        first, known = sources[0].description, _known(out, options.domain)
        selection = select(first, options)
        for source in sources[1:]:
            check_same(source.description, first, selection)
        read, dropped = read_sources(sources, selection, options)
        limits = choose_limits(first, options, known, [one.episode.actions for one in read])
        sizes = (selection.observation, first.action_size, _rate(first, options, known))
        spec = DomainSpec(options.domain, *sizes, first.env, limits.low, limits.high)
        done = _outcome(read, spec, {**selection.dropped, **dropped}, sources, limits.told_by)
        trajectories = (_trajectory(one, spec, options, first.scaled) for one in read)
        described = [describe_sources(source.description) for source in sources]
        provenance = {**record, "format": form.title, "source": described, **_told(done)}
        add_trajectories(out, [spec], [*done.tasks], trajectories, provenance)
    return done


def _opened(form: Format, path: Path, stack: ExitStack) -> Source:
    with understood(path):
        return stack.enter_context(form.open(path))


def _known(out: Path, domain: str) -> DomainSpec | None:
    """The domain in our file, if it is there already."""
    if not out.exists():
        return None
    with TrajectoryFile.open(out) as file:
        return next((spec for spec in file.domains if spec.name == domain), None)


def _rate(source: SourceDescription, options: ImportOptions, known: DomainSpec | None) -> float:
    rates = (options.fps, source.fps, None if known is None else known.control_hz)
    fps = next((rate for rate in rates if rate is not None), None)
    if fps is None or not 0 < fps < math.inf:
        found = "no rate" if fps is None else f"{fps:g} steps a second"
        refuse_source(source.place, found, "a positive number of them: state it by --fps")
    return float(fps)


def _outcome(
    read: Sequence[Read], spec: DomainSpec, dropped: Mapping[str, str], sources: Sequence[Source], limits: str
) -> Imported:
    warnings = dict.fromkeys(text for source in sources for text in source.description.warnings)
    steps = sum(len(one.episode.actions) for one in read)
    return Imported(spec, len(read), steps, Counter(one.task for one in read), dropped, [*warnings], limits)


def _told(done: Imported) -> dict[str, Any]:
    """Provenance of an import."""
    told = {"imported": done.demonstrations, "dropped": dict(done.dropped), "warnings": [*done.warnings]}
    return {**told, "action_limits": done.limits}


def _trajectory(one: Read, spec: DomainSpec, options: ImportOptions, scaled: bool) -> Trajectory:
    actions = scale(one.episode, spec, options, scaled)
    observation = Observation(one.state, cast("Mapping[str, np.ndarray]", one.images))
    return Trajectory(spec.name, one.task, observation, actions, one.seed, one.episode.success is not False)
