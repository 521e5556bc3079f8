"""Being asked to stop where there is no step to save: leave at once, and say so in the run's status."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from plp_lightning.callbacks.preemption import PreemptedError


@contextmanager
def stoppable() -> Iterator[None]:
    """Raise PreemptedError wherever SIGTERM or SIGINT finds the block.

    All files are complete, so that a resumed run repeats no more than collection or evaluation, whichever was going
    on. While steps are trained, :class:`Preemption` listens instead and saves first.
    """
    previous = {number: signal.signal(number, _leave) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None) -> None:
    raise PreemptedError(number)
