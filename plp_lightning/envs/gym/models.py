"""MuJoCo's models, compiled once for all environments of a process: that takes most of the time to make one."""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

KEPT = 8  # models of a process
_models: dict[tuple[object, ...], Any] = {}  # as they were compiled; environments get copies, and may change them


@contextmanager
def compiled_once() -> Iterator[None]:
    """Let environments that are made in the block load a file of MuJoCo's at the price of a copy, if one did before.

    A file that has changed is another one, and so is one with assets beside it.
    """
    kind = getattr(sys.modules.get("mujoco"), "MjModel", None)
    if kind is None:
        yield
        return
    compiling = kind.from_xml_path

    def from_xml_path(path: str, *assets: Any, **named: Any) -> Any:
        return compiling(path, *assets, **named) if assets or named else _copied(path, compiling)

    kind.from_xml_path = staticmethod(from_xml_path)
    try:
        yield
    finally:
        kind.from_xml_path = staticmethod(compiling)


def _copied(path: str, compiling: Any) -> Any:
    try:
        found = os.stat(path)
    except (OSError, TypeError, ValueError):
        return compiling(path)  # which tells what is wrong
    key = (os.path.abspath(path), found.st_mtime_ns, found.st_size, found.st_ino)
    if key not in _models:
        if len(_models) == KEPT:
            del _models[next(iter(_models))]
        _models[key] = compiling(path)
    return copy.copy(_models[key])
