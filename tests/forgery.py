"""Changes of trajectory files and checkpoints that the project's own writers would never make."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import h5py

from datamodules.store.schema import stored_digest


def flip(file: Path, array: str, share: float) -> None:
    """Flip one bit of an array's stored bytes, at a share of them; nothing else of the file knows."""
    with h5py.File(file) as content:
        stored = content[array]
        place = stored.id.get_offset() + int(share * (stored.nbytes - 1))
    damaged = bytearray(file.read_bytes())
    damaged[place] ^= 1
    file.write_bytes(damaged)


def forge(file: Path, array: str, rows: Any, value: Any) -> None:
    """Write values into an array, and its right hash with them, as only another program would."""
    with h5py.File(file, "r+") as content:
        content[array][rows] = value
        hashes = json.loads(content.attrs["content_sha256"])
        assert f"/{array}" in hashes
        hashes[f"/{array}"] = stored_digest(content[array])
        content.attrs["content_sha256"] = json.dumps(hashes, sort_keys=True)


def flip_a_weight(file: Path) -> None:
    """Flip the lowest bit of the largest tensor's middle byte, which torch reads without a word."""
    with zipfile.ZipFile(file) as archive:
        tensors = [member for member in archive.infolist() if "/data/" in member.filename]
        largest = max(tensors, key=lambda member: member.file_size)
        stored = archive.read(largest)
    whole = bytearray(file.read_bytes())
    whole[whole.index(stored) + len(stored) // 2] ^= 1
    file.write_bytes(whole)
