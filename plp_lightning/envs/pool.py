"""Episodes shared out to processes, which step their shares at the same time."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
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
from plp_lightning.envs.tasks import Tasks

_TOLD = ("success", "invalid")


class Share(Protocol):
    """Episodes of one process. What else it has can be asked for by :meth:`Pool.rows`."""

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin episodes ``(E,)``; gives their first observations."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step with actions ``(n, A)`` in the episodes ``(n,)``."""


class Recipe(Protocol):
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
    """So many processes with a share of the episodes each; episode i is in share i modulo their number.

    One share alone stays in this process.

    Args:
        recipe: Makes the shares.
        count: Number of shares.
    """

    def __init__(self, recipe: Recipe, count: int) -> None:
        self.shares: list[Share | Connection] = (
            [recipe.share()] if count == 1 else [_begun(recipe) for _ in range(count)]
        )
        weakref.finalize(self, _close, self.shares)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        """Begin E episodes; gives their first observations ``(E, …)``."""
        rows = self._by_share(np.arange(len(tasks)))
        asked = {i: ([tasks[row] for row in at], [seeds[row] for row in at]) for i, at in rows.items()}
        return _shown(self._ask("reset", asked), rows)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        """Take a step in the episodes ``(n,)``, with actions ``(n, A)``."""
        rows = self._by_share(episodes)
        parts = self._ask("step", {i: (actions[at], self._places(episodes[at])) for i, at in rows.items()})
        shown = _shown({i: part.observation for i, part in parts.items()}, rows)
        success, invalid = (_joined({i: getattr(part, told) for i, part in parts.items()}, rows) for told in _TOLD)
        ended = {i: part.over for i, part in parts.items() if part.over is not None}
        return Step(shown, success, invalid, _joined(ended, rows) if ended else None)

    def rows(self, what: str, episodes: np.ndarray, *words: object) -> np.ndarray:
        """Rows ``(n, …)`` of the episodes ``(n,)`` by the shares' method of this name, which also takes ``words``."""
        rows = self._by_share(episodes)
        parts = self._ask(what, {i: (self._places(episodes[at]), *words) for i, at in rows.items()})
        return _joined({i: np.stack(given) for i, given in parts.items()}, rows)

    def _by_share(self, episodes: np.ndarray) -> dict[int, np.ndarray]:
        """Rows of each share that has some of the episodes ``(n,)``."""
        share = episodes % len(self.shares)
        rows = {i: np.flatnonzero(share == i) for i in range(len(self.shares))}
        return {i: at for i, at in rows.items() if len(at)}

    def _places(self, episodes: np.ndarray) -> np.ndarray:
        """Places of episodes ``(n,)`` of one share in it."""
        return episodes // len(self.shares)

    def _ask(self, what: str, words: dict[int, tuple[Any, ...]]) -> dict[int, Any]:
        """Ask shares, all at once, for what they do; gives their answers."""
        asked = {i: self.shares[i] for i in words}
        for i, share in asked.items():
            if isinstance(share, Connection):
                with contextlib.suppress(OSError):  # whether it died shows when it is listened to
                    share.send((what, words[i]))
        return {
            i: _answer(share) if isinstance(share, Connection) else getattr(share, what)(*words[i])
            for i, share in asked.items()
        }


def _joined(parts: Mapping[int, np.ndarray], rows: Mapping[int, np.ndarray]) -> np.ndarray:
    """Rows ``(n, …)`` of all shares in their order."""
    (first, *_), count = parts.values(), sum(map(len, rows.values()))
    whole: np.ndarray = np.empty((count, *first.shape[1:]), first.dtype)
    for i, part in parts.items():
        whole[rows[i]] = part
    return whole


def _shown(parts: Mapping[int, Observation[np.ndarray]], rows: Mapping[int, np.ndarray]) -> Observation[np.ndarray]:
    """Observations ``(n, …)`` of all shares in their order."""
    names = next(iter(parts.values())).images
    images = {name: _joined({i: part.images[name] for i, part in parts.items()}, rows) for name in names}
    return Observation(_joined({i: part.state for i, part in parts.items()}, rows), images)


def _begun(recipe: Recipe) -> Connection:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    context.Process(target=_serve, args=(there, recipe), daemon=True).start()
    there.close()
    return here


def _close(shares: Sequence[Share | Connection]) -> None:
    for share in shares:
        if isinstance(share, Connection):
            share.close()  # its process hears the end of the line


def _answer(share: Connection) -> Any:
    try:
        found = share.recv()
    except (EOFError, OSError) as error:
        raise RuntimeError("a process that steps environments has died") from error
    if isinstance(found, BaseException):
        raise found
    return found


def _serve(connection: Connection, recipe: Recipe) -> None:
    """Do what is asked for until the other end is closed, in a process of its own."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)  # the parent hears them
    share = recipe.share()
    with contextlib.suppress(EOFError, OSError):
        while True:
            what, words = connection.recv()
            connection.send(_done(share, what, words))
    os._exit(0)


def _done(share: Share, what: str, words: tuple[Any, ...]) -> Any:
    try:
        return getattr(share, what)(*words)
    except UserError as error:
        return UserError(str(error))
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return RuntimeError(f"{type(error).__name__}: {error} ({os.path.basename(place.filename)}:{place.lineno})")
