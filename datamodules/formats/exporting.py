"""Common parts of all exporters: a domain's demonstrations, and files and folders that are complete or absent."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from datamodules.errors import TrajectoryFileError
from datamodules.formats.source import check_new
from datamodules.store.atomic import locked_folder, replacing
from datamodules.store.reader import TrajectoryFile
from datamodules.types import DomainSpec


class Demonstration(NamedTuple):
    """A demonstration on its way out."""

    task: str
    seed: int
    success: bool
    state: np.ndarray  # ``(T + 1, O)`` float32; ``(T, O)`` if nobody knows what was seen last
    images: Mapping[str, np.ndarray]  # By camera ``(T + 1, H, W, C)`` or ``(T, H, W, C)`` uint8
    actions: np.ndarray  # ``(T, A)`` float32 in [-1, 1]

    def values(self, spec: DomainSpec) -> dict[str, np.ndarray]:
        """Observations by key: ``(T + 1, n)`` float32, ``(T + 1, H, W, C)`` uint8; T rows if the last is unknown."""
        values = {key.name: self.state[:, spec.columns([key.name])] for key in spec.state_keys}
        return values | dict(self.images)


def demonstrations(file: TrajectoryFile, domain: str) -> Iterator[Demonstration]:
    """Demonstrations of a domain, states ``(T + 1, O)``, in the order of the file, one in memory at a time."""
    for number in range(len(file.episodes(domain).task)):
        found = file.trajectory(domain, number)
        observation = found.observation
        yield Demonstration(found.task, found.seed, found.success, observation.state, observation.images, found.actions)


@contextmanager
def new_file(out: Path) -> Iterator[Path]:
    """Give a temporary path for a file that is there at ``out`` once the block succeeds."""
    out = out.absolute()
    check_new(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with _writable(out), locked_folder(out.parent), replacing(out) as temporary:
        yield temporary


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a temporary folder that is there at ``out`` once the block succeeds."""
    out = out.absolute()
    check_new(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with _writable(out):
        temporary = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".tmp", dir=out.parent))
        try:
            yield temporary
            temporary.chmod(0o755)
            os.rename(temporary, out)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _writable(out: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        expected = "expected a folder with free space: make room or choose another"
        raise TrajectoryFileError(f"{out}: cannot be written ({' '.join(str(error).split())}); {expected}") from error
