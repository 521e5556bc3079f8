"""FORMATS: files of other projects, read with the same care as our own, and where they came from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from datamodules.formats.source import SourceDescription

_BLOCK_BYTES = 2**20


def describe_source(path: Path) -> dict[str, object]:
    """Name, size in bytes and SHA-256 of the file at ``path``, as JSON can hold them."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return {"file": path.name, "bytes": path.stat().st_size, "sha256": digest.hexdigest()}


def describe_sources(source: SourceDescription) -> dict[str, object]:
    """Description of a source's only file; or of its folder, with a SHA-256 over its files' names and contents."""
    if [*source.files] == [source.place]:
        return describe_source(source.place)
    found = [describe_source(path) for path in source.files]
    names = [path.relative_to(source.place) for path in source.files]
    lines = [f"{one['sha256']}  {name}\n" for one, name in sorted(zip(found, names, strict=True), key=lambda p: p[1])]
    size = sum(path.stat().st_size for path in source.files)
    digest = hashlib.sha256("".join(lines).encode(errors="replace")).hexdigest()
    return {"folder": source.place.name, "files": len(lines), "bytes": size, "sha256": digest}
