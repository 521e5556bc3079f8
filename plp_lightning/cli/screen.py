"""Standard output and error that outlive their reader: a run goes on when nobody looks any more."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from typing import Any, TextIO

lost: list[OSError] = []
"""What became of the output, if it could not be written; empty while all is well."""


class _Screen(io.FileIO):
    """Writes to a descriptor until that fails, then nowhere."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)

    def write(self, content: Any) -> int:
        try:
            return super().write(content)
        except OSError as error:
            lost.append(error)
            # Nothing that still writes there, C code too, shall fail.
            with contextlib.suppress(OSError), open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), self.fileno())
            return memoryview(content).nbytes


def steady_screen() -> None:
    """Put streams in place that do not fail: if nobody reads, if the disk is full, or if a letter can't be shown."""
    sys.stdout, sys.stderr = _steady(sys.stdout, 1), _steady(sys.stderr, 2)


def _steady(stream: TextIO | None, descriptor: int) -> TextIO:
    if stream is None:  # closed by whoever started the process
        return open(os.devnull, "w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper) or isinstance(getattr(stream.buffer, "raw", None), _Screen):
        return stream
    with contextlib.suppress(OSError, io.UnsupportedOperation):
        if stream.fileno() == descriptor:
            stream.flush()
            lines = descriptor == 2 or stream.isatty()
            raw: io.RawIOBase = _Screen(descriptor)
            return io.TextIOWrapper(io.BufferedWriter(raw), stream.encoding, "replace", line_buffering=lines)
    return stream


def loss() -> str | None:
    """Reason why output could not be written; None if it was, or if its reader had seen enough."""
    sys.stdout.flush()
    return next((str(error.strerror) for error in lost if error.errno != errno.EPIPE), None)
