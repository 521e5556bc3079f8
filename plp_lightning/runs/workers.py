"""Processes that work on jobs: they end with their parent, and one that dies, fails or is silent is told of."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import TracebackType
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from datamodules.errors import UserError
from plp_lightning.envs.faults import SimulatorError
from plp_lightning.parent import end_with_parent
from plp_lightning.stopping import SIGNALS

if TYPE_CHECKING:
    from typing_extensions import Self

SILENT_SECONDS = 60.0  # After so long without a result a process is told of, and again after as long
TICK_SECONDS = 1.0  # So often whoever waits for results hears that there is none

J = TypeVar("J")
R = TypeVar("R")


class WorkError(UserError):
    """A process died or failed."""


class Workers(Generic[J, R]):
    """Processes that each work on one job at a time, started afresh (spawn); use as a context manager.

    Jobs say in words what is done: ``str(job)`` is "demonstrating task …".

    They ignore the signals that a terminal or a scheduler sends to all processes at once: the parent hears them,
    and kills them when the block ends, wherever they hang. If the parent is killed they go with it.

    Args:
        count: Number of processes.
        work: Gives the results of a job one by one; called in the processes, so it has to be picklable.
    """

    def __init__(self, count: int, work: Callable[[J], Iterator[R]]) -> None:
        self.processes: dict[Connection, SpawnProcess] = {}
        self.jobs: dict[Connection, J] = {}  # What each process works on
        self.heard: dict[Connection, float] = {}  # When something was last heard of each, or told of it
        self.count, self.work = count, _pickled(work)

    def __enter__(self) -> Self:
        context = multiprocessing.get_context("spawn")
        try:
            for _ in range(self.count):
                here, there = context.Pipe()
                process = context.Process(target=_serve, args=(there, self.work))
                with _blocked_signals():
                    process.start()
                there.close()
                self.processes[here] = process
        except BaseException:
            self._kill()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._kill()

    def _kill(self) -> None:
        for process in self.processes.values():
            process.kill()  # one that is stopped or hangs in C would not hear anything else
        for connection, process in self.processes.items():
            process.join(5)
            connection.close()

    def results(self, jobs: Iterable[J], silent: Callable[[str], None]) -> Iterator[tuple[J, R] | None]:
        """Results of all jobs as they come, with the job; None now and then, while none comes.

        Args:
            jobs: The jobs, begun in this order.
            silent: Hears, in words, of a process that has not given a result for a long time.

        Raises:
            UserError: If a job raised one.
            WorkError: If a job raised something else, or a process died.
        """
        waiting = iter(jobs)
        for connection in self.processes:
            self._begin(connection, waiting)
        while self.jobs:
            for ready in wait(list(self.jobs), TICK_SECONDS):
                connection = cast("Connection", ready)
                if made := self._receive(connection):
                    yield self.jobs[connection], made[0]
                else:
                    self._begin(connection, waiting)
            yield None
            self._tell_silent(silent)

    def _begin(self, connection: Connection, waiting: Iterator[J]) -> None:
        self.jobs.pop(connection, None)
        for job in waiting:
            self.jobs[connection], self.heard[connection] = job, time.monotonic()
            with contextlib.suppress(OSError):  # whether it died shows when it is listened to
                connection.send(job)
            break

    def _receive(self, connection: Connection) -> list[R]:
        """One result, or none if the job is done."""
        try:
            message: list[R] | BaseException = connection.recv()
        except (EOFError, OSError) as error:
            raise WorkError(self._obituary(connection)) from error
        self.heard[connection] = time.monotonic()
        if isinstance(message, UserError):  # of the work
            raise message
        if isinstance(message, BaseException):
            raise WorkError(f"{self.jobs[connection]} failed: {message}")
        return message

    def _obituary(self, connection: Connection) -> str:
        process = self.processes[connection]
        process.join(5)
        code = process.exitcode or 0
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        why = " (the system does so when memory runs out)" if code == -signal.SIGKILL else ""
        return f"process {process.pid}, {self.jobs[connection]}, {how}{why}"

    def _tell_silent(self, silent: Callable[[str], None]) -> None:
        now = time.monotonic()
        for connection, job in self.jobs.items():
            if now - self.heard[connection] >= SILENT_SECONDS:
                silent(f"nothing for {SILENT_SECONDS:g} s from process {self.processes[connection].pid}, {job}")
                self.heard[connection] = now


def _pickled(work: Callable[[J], Iterator[R]]) -> bytes:
    """Pickled here, and read where a failure can be told in one line."""
    try:
        return pickle.dumps(work)
    except Exception as error:
        found = f"simulators and experts cannot be sent to other processes ({error})"
        raise UserError(f"{found}; expected objects that can be pickled until their first reset: mend them") from error


@contextlib.contextmanager
def _blocked_signals() -> Iterator[None]:
    """Processes that are started in the block never hear these signals, from its first instruction on."""
    resource_tracker.ensure_running()  # with the first process it would start too, and lift the block when it has
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, work: bytes) -> None:
    """Work on jobs until there are no more, in a process of its own; a list with a result, or empty at a job's end."""
    _leave_with_parent()
    try:
        results: Callable[[object], Iterator[object]] = pickle.loads(work)
        while True:
            for result in results(connection.recv()):
                connection.send([result])
            connection.send([])
    except SimulatorError as error:
        connection.send(RuntimeError(str(error)))
    except UserError as error:
        connection.send(UserError(str(error)))  # those of other classes may need more than a message
    except (EOFError, BrokenPipeError):
        pass  # the parent is gone
    except Exception as error:
        connection.send(RuntimeError(_summary(error)))


def _summary(error: BaseException) -> str:
    """Kind, message and place of an error; the place is the last one that no installed package has."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    message = " ".join(str(error).split())
    return f"{type(error).__name__}: {message} ({own[-1].filename}:{own[-1].lineno})"


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None, "called in a process that was started here"
    end_with_parent()
    threading.Thread(target=_leave_after, args=(parent.sentinel,), daemon=True).start()


def _leave_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
