"""Being asked to stop by a signal: by a terminal, a scheduler or a user, who all read the exit code."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1)
"""Signals that ask to save and leave; SLURM sends USR1 some time before a job's end, a lost terminal HUP."""


class PreemptedError(BaseException):
    """The process was asked to stop by a signal of that number, and has saved where it stands.

    Like KeyboardInterrupt it is no Exception, so that nothing that survives the failures of others swallows it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_code = 128 + number


def listen(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Let ``handler`` hear :data:`SIGNALS`, but HUP if the parent process chose to ignore it, as nohup does.

    Returns:
        The handlers before, by signal; none outside the main thread, which alone may set them.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    ignored = [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else []
    return {number: signal.signal(number, handler) for number in SIGNALS if number not in ignored}


@contextmanager
def stoppable() -> Iterator[None]:
    """Raise PreemptedError wherever a signal finds the block.

    All files are complete, so that a resumed run repeats no more than collection or evaluation, whichever was going
    on. While steps are trained, :class:`~plp_lightning.callbacks.preemption.Preemption` listens and saves first.
    """
    previous = listen(_leave)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None) -> None:
    raise PreemptedError(number)
