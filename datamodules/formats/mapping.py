"""Ways of another project's demonstrations into ours: which keys, under which names, of which task and size."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from datamodules.errors import ConfigError
from datamodules.formats.frames import image_shape
from datamodules.formats.metadata import read_object
from datamodules.formats.source import SourceDescription, SourceEpisode, SourceKey, refuse_source
from datamodules.store.guard import is_name
from datamodules.store.schema import is_task
from datamodules.types import ObservationKey


@dataclass(frozen=True)
class ImportOptions:
    """Options by which demonstrations of other projects become ours.

    Args:
        domain: Name of the domain that they are of.
        state: Keys of the state, in this order; every vector if none is named.
        without_state: Leave all vectors out: the domain shows images alone.
        image: Keys of the cameras, in this order; every camera if none is named.
        without_images: Leave all cameras out.
        rename: Other names for keys, each as OLD=NEW.
        resize: Height and width of the images in our file, such as 64 64; of one camera as KEY=64x64.
        task: Task of all demonstrations.
        task_key: Key or info whose value, the same in all steps of a demonstration, is its task.
        task_map: JSON file with an object: task in the source → its name in our file, or null to leave it out.
        first_seed: Seed of the first demonstration that has none; later ones count on.
        fps: Control steps a second, if the source does not say, or not the truth.
        action_low: What -1 stands for in the owner's units: one number, or one an action.
        action_high: What 1 stands for in the owner's units: one number, or one an action.
        clip_actions: Clip actions beyond their limits, instead of refusing them.
        incomplete: Take what is there of a source that should have more.
    """

    domain: str
    state: tuple[str, ...] = ()
    without_state: bool = False
    image: tuple[str, ...] = ()
    without_images: bool = False
    rename: tuple[str, ...] = ()
    resize: tuple[str, ...] = ()
    task: str | None = None
    task_key: str | None = None
    task_map: Path | None = None
    first_seed: int = 0
    fps: float | None = None
    action_low: tuple[float, ...] = ()
    action_high: tuple[float, ...] = ()
    clip_actions: bool = False
    incomplete: bool = False

    def __post_init__(self) -> None:
        if not is_name(self.domain):
            raise ConfigError(f"--domain is {self.domain!r}; expected 1 to 64 letters, digits, '_', '.', '-'")
        read_sizes(self.resize)
        if not 0 <= self.first_seed < 2**32:
            raise ConfigError(f"--first_seed is {self.first_seed}; expected a whole number from 0 to {2**32 - 1}")
        if bool(self.action_low) != bool(self.action_high):
            raise ConfigError("one of --action_low and --action_high is missing; expected both or neither")
        for name, left in (("image", self.without_images), ("state", self.without_state)):
            if left and getattr(self, name):
                other = "--without_images" if name == "image" else "--without_state"
                raise ConfigError(f"--{name} and {other} contradict each other; leave one away")


@dataclass(frozen=True)
class Selection:
    """The part of a source that becomes our observations."""

    state: tuple[SourceKey, ...]
    images: tuple[SourceKey, ...]
    observation: tuple[ObservationKey, ...]  # What they are in our file, in this order, images last
    dropped: dict[str, str]  # What is left out, and why

    @property
    def keys(self) -> tuple[SourceKey, ...]:
        """All keys that are read as observations."""
        return (*self.state, *self.images)

    @property
    def cameras(self) -> list[tuple[SourceKey, ObservationKey]]:
        """Cameras in the source, and what they are in our file."""
        return [*zip(self.images, self.observation[len(self.state) :], strict=True)]


def select(source: SourceDescription, options: ImportOptions) -> Selection:
    """Choose the keys that the options name, or all vectors and all cameras.

    Raises:
        ConfigError: If they name a key that is not there or of another kind, or twice.
    """
    state, images = _state(source, options), _images(source, options)
    chosen = (*state, *images)
    if not chosen:
        refuse_source(source.place, "no vector to make a state of, and no camera", "one at least: name it by --state")
    names, sizes = _names(chosen, options.rename), read_sizes(options.resize)
    for name in sizes:
        if name and name not in (known := [key.name for key in images]):
            unknown(name, known, f"{source.place}: --resize")
    observation = [ObservationKey(names[key.name], (math.prod(key.shape),)) for key in state]
    for key in images:
        size = sizes.get(key.name, sizes.get("", key.shape[:2]))
        observation.append(ObservationKey(names[key.name], (*size, key.shape[2]), "image"))
    others = [key for key in source.keys if key not in chosen and key.name != options.task_key]
    reasons = {key.name: _reason(key, bool(options.state)) for key in others}
    return Selection(state, images, tuple(observation), {**source.dropped, **reasons})


def _state(source: SourceDescription, options: ImportOptions) -> tuple[SourceKey, ...]:
    vectors = [key for key in source.keys if not key.image]
    if options.state:
        return _find(options.state, vectors, source, "--state")
    return tuple(key for key in vectors if len(key.shape) < 2 and not key.aside and not options.without_state)


def _images(source: SourceDescription, options: ImportOptions) -> tuple[SourceKey, ...]:
    cameras = [key for key in source.keys if key.image]
    if options.image:
        return _find(options.image, cameras, source, "--image")
    return () if options.without_images else tuple(cameras)


def _find(
    names: Sequence[str], keys: Sequence[SourceKey], source: SourceDescription, option: str
) -> tuple[SourceKey, ...]:
    if len({*names}) < len(names):
        raise ConfigError(f"{option} is {' '.join(names)}; expected every key once")
    known = {key.name: key for key in keys}
    return tuple(known.get(name) or unknown(name, [*known], f"{source.place}: {option}") for name in names)


def read_sizes(words: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Read heights and widths by camera; under the empty name that of all others, which stands in two words.

    Raises:
        ConfigError: If a word is no such size.
    """
    plain, named = ([word for word in words if ("=" in word) is told] for told in (False, True))
    pairs = [("", "x".join(plain)), *((key, size) for key, _, size in (word.rpartition("=") for word in named))]
    sizes: dict[str, tuple[int, int]] = {}
    for key, size in pairs if plain else pairs[1:]:
        found = re.fullmatch(r"([1-9]\d{0,8})x([1-9]\d{0,8})", size)
        if found is None or not image_shape((int(found[1]), int(found[2]), 3)):
            told = f"--resize is {' '.join(words)}"
            raise ConfigError(f"{told}; expected height and width in pixels, or KEY=HEIGHTxWIDTH for one camera")
        sizes[key] = int(found[1]), int(found[2])
    return sizes


def unknown(name: str, known: Sequence[str], place: str) -> NoReturn:
    """Raise a :class:`ConfigError` on a name that is not among the known ones, with the nearest of them."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    raise ConfigError(f"{place}: found no {name!r}{hint}; expected one of: {', '.join(known) or 'none'}")


def _names(keys: Sequence[SourceKey], rename: Iterable[str]) -> dict[str, str]:
    names = {key.name: key.name for key in keys}
    for pair in rename:
        old, equals, new = pair.rpartition("=")
        if not equals or not is_name(new):
            raise ConfigError(f"--rename is {pair!r}; expected OLD=NEW, NEW of letters, digits, '_', '.' and '-'")
        if old not in names:
            unknown(old, [*names], "--rename")
        names[old] = new
    for old, new in names.items():
        if not is_name(new):
            raise ConfigError(f"key {old!r} is no name in our files; expected --rename '{old}=NEW'")
    return names


def _reason(key: SourceKey, named: bool) -> str:
    if key.image:
        return "a camera that was not asked for"
    if key.aside:
        return "no observation"
    return "not asked for" if named else f"no vector, of shape {key.shape}"


class TaskNames:
    """Names the tasks of demonstrations as the options say.

    Args:
        options: Task, key or map.

    Raises:
        TrajectoryFileError: If the map cannot be read.
        ConfigError: If it names a task that cannot be one.
    """

    def __init__(self, options: ImportOptions) -> None:
        self.options, self.map = options, {} if options.task_map is None else read_object(options.task_map)
        self.met = dict[str, None]()
        for old, new in self.map.items():
            if new is not None and not (isinstance(new, str) and is_task(new)):
                raise ConfigError(f"{options.task_map}: {old!r} becomes {new!r}; expected a task's name, or null")

    def of(self, episode: SourceEpisode) -> str | None:
        """Name of an episode's task; None if it is to be left out."""
        task = self.options.task or self._told(episode)
        self.met[task] = None
        name: str | None = self.map.get(task, task)
        if name is not None and not is_task(name):
            episode.refuse("task", repr(name[:100]), "printable text: map it by --task_map")
        return name

    def check_map(self) -> None:
        """Refuse, by a :class:`ConfigError`, a map of tasks that no demonstration has."""
        for task in self.map:
            if task not in self.met:
                unknown(task, [*self.met], f"{self.options.task_map}")

    def _told(self, episode: SourceEpisode) -> str:
        key = self.options.task_key
        if key is None:
            task = episode.task or episode.refuse("task", "none", "one: state --task or --task_key")
            return " ".join(task.split())
        values = np.asarray(episode.values[key])
        values = values[:, 0] if values.shape[1:] == (1,) else values
        changes = np.flatnonzero([value != values[0] for value in values]) if values.ndim == 1 else [0]
        if len(values) == 0 or len(changes):
            found = f"values of shape {values.shape}" if values.ndim != 1 else "another value than before"
            episode.refuse(key, found, "one text or number, the same in all steps", int(changes[0]))
        value = values[0].decode(errors="replace") if isinstance(values[0], bytes) else str(values[0])
        return " ".join(value.split())
