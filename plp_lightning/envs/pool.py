"""Episodes shared out to processes, which step their shares at the same time."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import traceback
import weakref
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from datamodules.errors import UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.board import BOARD, Board, part_of_board, shared_board
from plp_lightning.envs.tasks import Tasks
from plp_lightning.stopping import SIGNALS

_BELL = b""  # asks for a step, and answers that it was taken


class Share(Protocol):
    """Episodes of one process. What else it has can be asked for by ``rows``."""

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes ``(E,)``; gives their first observations."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step with actions ``(n, A)`` in the episodes ``(n,)``."""


class ShareFactory(Protocol):
    """All that it takes to make a share; plain data, for other processes."""

    def share(self) -> Share:
        """A new share."""


class PooledSimulator(Simulator):
    """A simulator whose episodes are shared out to processes."""

    _tasks: Tasks

    @property
    def tasks(self) -> Tasks:
        return self._tasks

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.tasks.check(tasks)
        return self._pool.reset(tasks, seeds)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        return self._pool.step(actions, episodes)

    @property
    @abstractmethod
    def _pool(self) -> Pool: ...


class Pool:
    """Shares of the episodes, the first in this process, each other one in its own; episode i is in share i modulo n.

    A process that only asked and waited would drive those that step from core to core, away from what they have cached.

    Args:
        factory: Makes the shares.
        count: Their number n.
    """

    def __init__(self, factory: ShareFactory, count: int) -> None:
        others = [_begun(factory) for _ in range(1, count)]
        weakref.finalize(self, _close, others)
        self.count, self.share, self.others = count, _Served(factory.share()), others

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin E episodes; gives their first observations ``(E, …)``."""
        rows = self._by_share(np.arange(len(tasks)))
        parts = self._asked("reset", {i: ([tasks[k] for k in at], [seeds[k] for k in at]) for i, at in rows.items()})
        names = next(iter(parts.values())).images
        images = {name: _joined({i: part.images[name] for i, part in parts.items()}, rows) for name in names}
        self._first = Observation(_joined({i: part.state for i, part in parts.items()}, rows), images)
        self._board: Board | None = None
        return self._first

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step in the episodes ``(n,)``, with actions ``(n, A)``."""
        if self.count == 1:
            return self.share.share.step(actions, episodes)
        if self._board is None:
            self._board, self.share.board = shared_board(self.others, self._first, actions.shape[1])
        self._board.ask(actions, episodes)
        self._answers(dict.fromkeys({*(episodes % self.count).tolist()}, _BELL))
        return self._board.step(episodes)

    def rows(self, what: str, episodes: np.ndarray, *words: object) -> np.ndarray:
        """Rows ``(n, …)`` of the episodes ``(n,)`` by the shares' method of this name, which also takes ``words``."""
        rows = self._by_share(episodes)
        parts = self._asked(what, {i: (episodes[at] // self.count, *words) for i, at in rows.items()})
        return _joined({i: np.stack(given) for i, given in parts.items()}, rows)

    def _by_share(self, episodes: np.ndarray) -> dict[int, np.ndarray]:
        """Rows of each share that has some of the episodes ``(n,)``."""
        share = episodes % self.count
        rows = {i: np.flatnonzero(share == i) for i in range(self.count)}
        return {i: at for i, at in rows.items() if len(at)}

    def _asked(self, what: str, words: Mapping[int, tuple[Any, ...]]) -> dict[int, Any]:
        """Answers of shares that are asked, all at once, for what they do."""
        return self._answers({i: pickle.dumps((what, own)) for i, own in words.items()})

    def _answers(self, messages: Mapping[int, bytes]) -> dict[int, Any]:
        others = {i: self.others[i - 1] for i in messages if i}
        for i, line in others.items():
            with contextlib.suppress(OSError):  # whether it died shows when it is listened to
                line.send_bytes(messages[i])
        found = {0: self._tried(messages[0])} if 0 in messages else {}
        found |= {i: _heard(line) for i, line in others.items()}  # all, so that none is left for the next question
        for answer in found.values():
            if isinstance(answer, Exception):
                raise answer
        return found

    def _tried(self, message: bytes) -> Any:
        try:
            return self.share.answer(message)
        except Exception as error:
            return error


class _Served:
    """A share that does what messages ask for: a step of what the board says, or what it can beside that."""

    def __init__(self, share: Share) -> None:
        self.share = share
        self.board: Board | None = None

    def answer(self, message: bytes) -> Any:
        """Do as a message says and give what came of it; None for a step, whose outcome the board has."""
        if message != _BELL:
            what, words = pickle.loads(message)
            return getattr(self.share, what)(*words)
        assert self.board is not None, "expected the board before the first step"
        actions, episodes = self.board.asked()
        self.board.tell(self.share.step(actions, episodes), episodes)
        return None

    def told(self, message: bytes) -> bytes:
        """The same or what went wrong, as another process reads it."""
        try:
            found = self.answer(message)
        except UserError as error:
            found = UserError(str(error))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            found = RuntimeError(f"{type(error).__name__}: {error} ({os.path.basename(place.filename)}:{place.lineno})")
        return _BELL if found is None else pickle.dumps(found)


def _joined(parts: Mapping[int, np.ndarray], rows: Mapping[int, np.ndarray]) -> np.ndarray:
    """Rows ``(n, …)`` of all shares in their order."""
    (first, *_), count = parts.values(), sum(map(len, rows.values()))
    whole: np.ndarray = np.empty((count, *first.shape[1:]), first.dtype)
    for i, part in parts.items():
        whole[rows[i]] = part
    return whole


def _begun(factory: ShareFactory) -> Connection:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    context.Process(target=_serve, args=(there, factory), daemon=True).start()
    there.close()
    return here


def _close(lines: Sequence[Connection]) -> None:
    for line in lines:
        line.close()  # its process hears the end of the line


def _heard(line: Connection) -> Any:
    try:
        told = line.recv_bytes()
    except (EOFError, OSError):
        return RuntimeError("a process that steps environments has died")
    return None if told == _BELL else pickle.loads(told)


def _serve(line: Connection, factory: ShareFactory) -> None:
    """Do what is asked for until the other end is closed, in a process of its own."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # the parent hears them
    served = _Served(factory.share())
    with contextlib.suppress(EOFError, OSError):
        while True:
            message = line.recv_bytes()
            if message == BOARD:
                served.board = part_of_board(line)
            else:
                line.send_bytes(served.told(message))
    os._exit(0)
