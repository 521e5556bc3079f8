"""A file for HDF5 to write to, which never tells HDF5 that the disk is full."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer


class PatientFile(io.RawIOBase):
    """A new file, open for HDF5 to write and read; it keeps the first refusal of the disk to itself.

    The HDF5 library breaks down when a write fails, with a full disk or a limit on file sizes. Here no write fails:
    after the first refusal all that HDF5 still writes is held in memory. Whoever writes asks :meth:`check` after each
    large piece, so that not more than one such piece is held.
    """

    def __init__(self, path: Path) -> None:
        self.refusal: OSError | None = None
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        self._at = self._size = 0
        self._held: list[tuple[int, bytes]] = []  # Where each block belongs, in the order of writing

    def check(self) -> None:
        """Raise the first refusal, if there was one.

        Raises:
            OSError: As the operating system gave it.
        """
        if self.refusal is not None:
            raise self.refusal

    def close(self) -> None:
        if not self.closed:
            os.close(self._descriptor)
        super().close()

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def write(self, block: Buffer) -> int:
        """Write all of a block, to memory if the disk has refused; returns its bytes."""
        view = memoryview(block).cast("B")
        if self.refusal is None:
            self._store(view)
        if self.refusal is not None:
            self._held.append((self._at, bytes(view)))
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def _store(self, view: memoryview) -> None:
        done = 0
        try:
            while done < len(view):
                done += os.pwrite(self._descriptor, view[done:], self._at + done)
        except OSError as error:
            self.refusal = error

    def readinto(self, buffer: Buffer) -> int:
        """Fill a buffer with what was written here, as far as the file goes; returns the bytes read."""
        view = memoryview(buffer).cast("B")[: max(0, self._size - self._at)]
        done, found = 0, b"begin"
        while done < len(view) and found:
            found = os.pread(self._descriptor, len(view) - done, self._at + done)
            view[done : done + len(found)] = found
            done += len(found)
        view[done:] = bytes(len(view) - done)
        for start, block in self._held:
            first, last = max(start, self._at), min(start + len(block), self._at + len(view))
            if first < last:
                view[first - self._at : last - self._at] = block[first - start : last - start]
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        self._size = self._at if size is None else size
        try:
            os.ftruncate(self._descriptor, self._size)
        except OSError as error:
            self.refusal = self.refusal or error
        return self._size
