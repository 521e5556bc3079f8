"""Demonstrations of open sources, checked value by value: ours but for their actions, which keep the owner's units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from datamodules.formats.frames import Frames
from datamodules.formats.mapping import ImportOptions, Selection, TaskNames, unknown
from datamodules.formats.source import Source, SourceDescription, SourceEpisode, SourceKey, refuse_source


class Read(NamedTuple):
    """A demonstration that was read, but for its images."""

    episode: SourceEpisode  # Without values
    task: str
    seed: int
    state: np.ndarray  # ``(T + 1, O)`` float32; ``(T, O)`` if nobody knows what was seen last
    images: Mapping[str, Frames]  # By name in our file


def read_sources(
    sources: Sequence[Source], selection: Selection, options: ImportOptions
) -> tuple[list[Read], dict[str, str]]:
    """Read all demonstrations, states ``(T + 1, O)``, and tell which were left out, and why.

    Raises:
        TrajectoryFileError: Naming the file, episode, key and step that is not as it should be, or what is missing.
        ConfigError: If an option names a key or a task that is not there.
    """
    names, dropped, read = TaskNames(options), Counter[str](), list[Read]()
    for source in sources:
        for one in _read(source, selection, names, options, dropped):
            seed = options.first_seed + len(read) if one.seed < 0 else one.seed
            read.append(one._replace(seed=seed))
    names.check_map()
    told = {reason: f"{count} demonstrations" for reason, count in dropped.items()}
    if not read:
        left = "; ".join(f"{count}: {reason}" for reason, count in told.items())
        refuse_source(sources[0].description.place, f"no demonstration to import {left}".strip(), "at least one")
    return read, told


@contextmanager
def understood(place: Path) -> Iterator[None]:
    """Turn what reading raises on values that no format foresees into a :class:`TrajectoryFileError`."""
    try:
        yield
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError, MemoryError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        refuse_source(place, f"something that cannot be understood ({reason})", "an undamaged file of this format")


def check_same(found: SourceDescription, first: SourceDescription, selection: Selection) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, sources that are not of one domain."""
    keys = {key.name: key for key in found.keys}
    for key in selection.keys:
        if key.name not in keys:
            unknown(key.name, [*keys], f"{found.place}")
        if keys[key.name] != key:
            shape = f"{key.shape}, as in {first.place}"
            refuse_source(found.place, f"{key.name} of shape {keys[key.name].shape}", shape)
    for name in ("action_size", "fps", "action_low", "action_high", "scaled"):
        if getattr(found, name) != getattr(first, name):
            expected = f"{getattr(first, name)}, as in {first.place}"
            refuse_source(found.place, f"{name} {getattr(found, name)}", expected)


def _read(
    source: Source, selection: Selection, names: TaskNames, options: ImportOptions, dropped: Counter[str]
) -> Iterator[Read]:
    described, count = source.description, 0
    for episode in _episodes(source, _wanted(described, selection, options)):
        task, count = names.of(episode), count + 1
        if task is None:
            dropped["task left out by --task_map"] += 1
        elif len(episode.actions) == 0:
            dropped["without a single action"] += 1
        else:
            yield _checked(episode, task, selection, described.action_size)
    found = described.lacks or (f"{count} demonstrations of {described.episodes}" if count < described.episodes else "")
    if found and not options.incomplete:
        refuse_source(described.place, found, "all of them: get the rest, or add --incomplete")


def _episodes(source: Source, keys: Sequence[str]) -> Iterator[SourceEpisode]:
    found = source.episodes(keys)
    while True:
        with understood(source.description.place):
            episode = next(found, None)
        if episode is None:
            return
        yield episode


def _wanted(source: SourceDescription, selection: Selection, options: ImportOptions) -> list[str]:
    """Names of the keys to read: those of the observation, and the one that names the task."""
    wanted, told = [key.name for key in selection.keys], options.task_key
    known = [key.name for key in source.keys if not key.image]
    if told is None or told in wanted:
        return wanted
    return [*wanted, told] if told in known else unknown(told, known, f"{source.place}: --task_key")


def _checked(episode: SourceEpisode, task: str, selection: Selection, action_size: int) -> Read:
    actions = episode.actions
    if actions.ndim != 2 or actions.shape[1] != action_size or actions.dtype.kind not in "fiu":
        episode.refuse("actions", f"shape {actions.shape}, type {actions.dtype}", f"(T, {action_size}), numbers")
    _check_finite(episode, "actions", actions)
    _check_rows(episode, selection.keys)
    rows = len(episode.values[selection.keys[0].name])
    state = np.concatenate([np.empty((rows, 0), np.float32), *(_vector(episode, key) for key in selection.state)], 1)
    images = {
        ours.name: cast("Frames", episode.values[key.name]).resized(ours.shape) for key, ours in selection.cameras
    }
    seed = -1 if episode.seed is None or not 0 <= episode.seed < 2**63 else episode.seed
    return Read(replace(episode, values={}), task, seed, state, images)


def _check_rows(episode: SourceEpisode, keys: Sequence[SourceKey]) -> None:
    rows, steps = len(episode.values[keys[0].name]), len(episode.actions)
    for key in keys:
        found = episode.values[key.name]
        if found.shape != (rows, *key.shape) or rows - steps not in (0, 1):
            expected = f"{(steps, *key.shape)}, or one row more of what was seen last"
            episode.refuse(key.name, f"shape {found.shape} for {steps} actions", expected)


def _vector(episode: SourceEpisode, key: SourceKey) -> np.ndarray:
    values = np.asarray(episode.values[key.name])
    if values.dtype.kind not in "fiub":
        episode.refuse(key.name, f"values of type {values.dtype}", "numbers")
    _check_finite(episode, key.name, values := values.reshape(len(values), -1))
    return values.astype(np.float32)


def _check_finite(episode: SourceEpisode, key: str, values: np.ndarray) -> None:
    with np.errstate(over="ignore"):
        bad = np.flatnonzero(~np.isfinite(values.astype(np.float32)).all(axis=1))
    if len(bad):
        episode.refuse(key, f"{values[bad[0]].tolist()}", "finite numbers", int(bad[0]))
