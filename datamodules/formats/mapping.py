"""Ways of another project's demonstrations into ours: which keys, under which names, of which task and size."""

from __future__ import annotations

import difflib
import math
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
        image: Key of the camera; needed if there are several, for a domain has one.
        without_images: Leave all cameras out.
        rename: Other names for keys, each as OLD=NEW.
        resize: Height and width of the images in our file.
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
    image: str | None = None
    without_images: bool = False
    rename: tuple[str, ...] = ()
    resize: tuple[int, ...] = ()
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
        if self.resize and (len(self.resize) != 2 or not image_shape((*self.resize, 3)) or min(self.resize) < 1):
            raise ConfigError(f"--resize is {' '.join(map(str, self.resize))}; expected height and width in pixels")
        if not 0 <= self.first_seed < 2**32:
            raise ConfigError(f"--first_seed is {self.first_seed}; expected a whole number from 0 to {2**32 - 1}")
        if bool(self.action_low) != bool(self.action_high):
            raise ConfigError("one of --action_low and --action_high is missing; expected both or neither")
        if self.image and self.without_images:
            raise ConfigError("--image and --without_images contradict each other; leave one away")


@dataclass(frozen=True)
class Selection:
    """The part of a source that becomes our observations."""

    state: tuple[SourceKey, ...]
    image: SourceKey | None
    observation: tuple[ObservationKey, ...]  # What they are in our file, in this order, the image last
    dropped: dict[str, str]  # What is left out, and why

    @property
    def keys(self) -> tuple[SourceKey, ...]:
        """All keys that are read as observations."""
        return self.state if self.image is None else (*self.state, self.image)


def select(source: SourceDescription, options: ImportOptions) -> Selection:
    """Choose the keys that the options name, or all vectors and the only camera.

    Raises:
        ConfigError: If they name a key that is not there or of another kind, or there are several cameras to choose.
    """
    state, image = _state(source, options), _image(source, options)
    chosen = state if image is None else (*state, image)
    names = _names(chosen, options.rename)
    observation = [ObservationKey(names[key.name], (math.prod(key.shape),)) for key in state]
    if image is not None:
        shape = (*options.resize, image.shape[2]) if options.resize else image.shape
        observation.append(ObservationKey(names[image.name], shape, "image"))
    others = [key for key in source.keys if key not in chosen and key.name != options.task_key]
    reasons = {key.name: _reason(key, bool(options.state)) for key in others}
    return Selection(state, image, tuple(observation), {**source.dropped, **reasons})


def _state(source: SourceDescription, options: ImportOptions) -> tuple[SourceKey, ...]:
    vectors = [key for key in source.keys if not key.image]
    if not options.state:
        chosen = tuple(key for key in vectors if len(key.shape) < 2 and not key.aside)
        return chosen or refuse_source(source.place, "no vector to make a state of", "at least one: name it by --state")
    if len({*options.state}) < len(options.state):
        raise ConfigError(f"--state is {' '.join(options.state)}; expected every key once")
    return tuple(_find(name, vectors, source, "--state") for name in options.state)


def _image(source: SourceDescription, options: ImportOptions) -> SourceKey | None:
    cameras = [key for key in source.keys if key.image]
    if options.without_images or not (cameras or options.image):
        return None
    if options.image is None and len(cameras) > 1:
        names = ", ".join(key.name for key in cameras)
        refuse_source(source.place, f"the cameras {names}", "one a domain: name it by --image, or add --without_images")
    return cameras[0] if options.image is None else _find(options.image, cameras, source, "--image")


def _find(name: str, keys: Sequence[SourceKey], source: SourceDescription, option: str) -> SourceKey:
    found = next((key for key in keys if key.name == name), None)
    return found or unknown(name, [key.name for key in keys], f"{source.place}: {option}")


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
