"""FORMATS: files of other projects, read with the same care as our own, and where they came from."""

from __future__ import annotations

import hashlib
from pathlib import Path

_BLOCK_BYTES = 2**20


def describe_source(path: Path) -> dict[str, object]:
    """Name, size in bytes and SHA-256 of the file at ``path``, as JSON can hold them."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return {"file": path.name, "bytes": path.stat().st_size, "sha256": digest.hexdigest()}
