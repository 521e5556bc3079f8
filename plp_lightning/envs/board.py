"""Memory that the processes of a pool share: a row an episode, with what is to be done in it and what came of it.

A step then takes a message of no content to a process and one back. Arrays in messages would be pickled, sent and read
twice, which takes as long as the steps of ten episodes.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any

import numpy as np

from datamodules.errors import UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Step

BOARD = b"board"  # announces one
_TOLD = ("success", "invalid", "over")
_IMAGE = "image "  # before a camera's name, so that it is no other field's


class Board:
    """Rows of episodes.

    Args:
        rows: Records ``(E,)`` with the fields of :func:`shared_board`.
    """

    def __init__(self, rows: np.ndarray) -> None:
        self.goes, self.actions, self.state = rows["goes"], rows["action"], rows["state"]
        cameras = [name for name in rows.dtype.names or () if name.startswith(_IMAGE)]
        self.images: Mapping[str, np.ndarray] = {name[len(_IMAGE) :]: rows[name] for name in cameras}
        self.told = {name: rows[name] for name in _TOLD}

    def ask(self, actions: np.ndarray, episodes: np.ndarray) -> None:
        """Want a step with actions ``(n, A)`` in the episodes ``(n,)``."""
        self.goes[:] = False
        self.goes[episodes], self.actions[episodes] = True, actions

    def asked(self) -> tuple[np.ndarray, np.ndarray]:
        """Actions ``(n, A)``, and the episodes ``(n,)`` in which a step is wanted."""
        episodes = np.flatnonzero(self.goes)
        return self.actions[episodes], episodes

    def tell(self, step: Step, episodes: np.ndarray) -> None:
        """Write what came of a step in the episodes ``(n,)``.

        Raises:
            UserError: If observations are of other shapes or types than the first ones.
        """
        _write(self.state, step.observation.state, episodes, "a state")
        for name, image in step.observation.images.items():
            _write(self.images[name], image, episodes, f"images of {name!r}")
        for name, told in self.told.items():
            given = getattr(step, name)
            told[episodes] = False if given is None else given

    def step(self, episodes: np.ndarray) -> Step:
        """The step, as it came about in the episodes ``(n,)``."""
        return Step(Observation(self.state, self.images).take(episodes), *(x[episodes] for x in self.told.values()))


def shared_board(lines: Sequence[Connection], first: Observation[np.ndarray], action_size: int) -> tuple[Board, Board]:
    """A board for episodes with these first observations ``(E, …)``, and the part of it that is this process's.

    Of n processes, this one has every n-th episode from the first on, that at the other end of the first line has them
    from the second on, and so forth. The memory is in no folder, and free when the last process that maps it ends.
    """
    count, size, memory = len(first.state), len(lines) + 1, _nameless()
    shown = {"state": first.state} | {f"{_IMAGE}{name}": images for name, images in first.images.items()}
    asked = [("goes", np.bool_), ("action", np.float64, (action_size,))]
    fields = [*asked, *((name, np.bool_) for name in _TOLD), *((k, x.dtype, x.shape[1:]) for k, x in shown.items())]
    try:
        for place, line in enumerate(lines, 1):
            with suppress(OSError):  # whether it died shows when it is asked for a step
                line.send_bytes(BOARD)
                line.send((count, fields, place, size))
                send_handle(line, memory, 0)  # the process's number matters on Windows alone
        rows = _mapped(memory, count, fields)
        return Board(rows), Board(rows[::size])
    finally:
        os.close(memory)


def part_of_board(line: Connection) -> Board:
    """The part that comes by the line after the message :data:`BOARD`."""
    count, fields, place, size = line.recv()
    memory = recv_handle(line)
    try:
        return Board(_mapped(memory, count, fields)[place::size])
    finally:
        os.close(memory)


def _nameless() -> int:
    """Descriptor of new memory."""
    if sys.platform == "linux":
        return os.memfd_create("episodes")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _mapped(memory: int, count: int, fields: list[tuple[Any, ...]]) -> np.ndarray:
    kind = np.dtype(fields, align=True)
    os.truncate(memory, max(1, count * kind.itemsize))
    rows: np.ndarray = np.ndarray(count, kind, mmap.mmap(memory, 0))
    return rows


def _write(place: np.ndarray, given: np.ndarray, episodes: np.ndarray, what: str) -> None:
    if given.shape[1:] != place.shape[1:] or given.dtype != place.dtype:
        found, first = (f"shape {x.shape[1:]}, type {x.dtype}" for x in (given, place))
        raise UserError(f"an environment shows {what} of {found}; expected {first}, as at the reset: mend it")
    place[episodes] = given
