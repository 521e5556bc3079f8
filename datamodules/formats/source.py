"""Formats of other projects as they look from here: demonstrations under names, in their owner's units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NoReturn, TypeAlias

import numpy as np

from datamodules.errors import ConfigError, TrajectoryFileError
from datamodules.formats.frames import Frames
from datamodules.settings import Configured
from datamodules.store.reader import TrajectoryFile

Values: TypeAlias = np.ndarray | Frames
NO_SUCCESS = "success is not stated: all demonstrations count as successful"


@dataclass(frozen=True)
class SourceKey:
    """Something that a source knows of every step."""

    name: str
    shape: tuple[
        int, ...
    ]  # Of one step: ``(n,)`` for a vector, ``()`` for a number or a text, ``(H, W, C)`` for an image
    image: bool = False  # A camera: uint8 in [0, 255]
    aside: bool = False
    """No observation, such as the number of a goal or a text: left out unless it is asked for, or names the task."""


@dataclass(frozen=True)
class SourceDescription:
    """Facts that a source tells of all its demonstrations before one of them is read."""

    place: Path  # The file or folder that it was opened by
    files: Sequence[Path]  # All files that belong to it, for the record
    keys: Sequence[SourceKey]
    action_size: int
    episodes: int  # As many demonstrations are promised
    lacks: str = ""  # What is known not to be there; empty if nothing is
    fps: float | None = None  # Control steps a second; None if the format does not say
    action_low: tuple[float, ...] | None = None  # ``(A,)``; None if the format does not say
    action_high: tuple[float, ...] | None = None
    scaled: bool = False  # Whether actions are in [-1, 1] already, whatever the limits
    env: str = ""  # What simulates it, for the record
    dropped: Mapping[str, str] = field(default_factory=dict)  # What is left out, and why, beside keys
    warnings: Sequence[str] = ()  # What a user should know of these files


@dataclass(frozen=True)
class SourceEpisode:
    """One demonstration of T actions, as its owner recorded it."""

    name: str  # Its name in the source, such as ``demo_3``
    place: Path  # The file that it is in
    values: Mapping[str, Values]
    """By key: ``(T + 1, …)``, or ``(T, …)`` where nobody knows what was seen last."""
    actions: np.ndarray  # ``(T, A)``
    task: str | None = None
    seed: int | None = None
    success: bool | None = None

    def refuse(self, key: str, found: str, expected: str, step: int | None = None) -> NoReturn:
        """Raise a :class:`TrajectoryFileError` that names file, episode, key and step."""
        at = "" if step is None else f", step {step}"
        raise TrajectoryFileError(f"{self.place}: {self.name}, {key}{at}: found {found}; expected {expected}")


class Source(ABC):
    """A file or folder of another project that is open for reading."""

    description: SourceDescription

    @abstractmethod
    def episodes(self, keys: Sequence[str]) -> Iterator[SourceEpisode]:
        """Demonstrations one by one, with the values of these keys; images ``(…, H, W, C)`` as :class:`Frames`.

        Raises:
            TrajectoryFileError: Naming file, episode, key and step that are not as they should be.
        """


class Format(Configured, ABC):
    """A way in which others keep demonstrations; its constructor's arguments are options of the command line.

    A format of one's own is a subclass, under any name of the entry point group ``plp.formats``.
    """

    title: ClassVar[str]

    @abstractmethod
    def open(self, path: Path) -> AbstractContextManager[Source]:
        """Open a file or folder for reading.

        Raises:
            TrajectoryFileError: If it is missing, damaged, hostile or of another format.
        """

    def write(self, file: TrajectoryFile, domain: str, out: Path) -> Sequence[str]:
        """Write a domain's demonstrations, states ``(T + 1, O)``, to a new file or folder.

        Further arguments of a format are options of ``plp data export``.

        Returns:
            What has no place in the format.

        Raises:
            ConfigError: If the format can only be read.
            TrajectoryFileError: If ``out`` exists or cannot be written.
        """
        raise ConfigError(f"{self.title} can only be imported; choose another format to export to")


def refuse_source(place: Path | str, found: str, expected: str) -> NoReturn:
    """Raise a :class:`TrajectoryFileError` on a file of another project."""
    raise TrajectoryFileError(f"{place}: found {found}; expected {expected}")


def check_new(out: Path) -> None:
    """Refuse, by a :class:`TrajectoryFileError`, to write where something is."""
    if out.exists() or out.is_symlink():
        raise TrajectoryFileError(f"{out}: exists; expected a new name: choose another or remove it")
