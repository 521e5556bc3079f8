"""Experts who made a file's demonstrations, as it tells of them, and where another expert differs."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import Any

from datamodules.settings import blueprint
from plp_lightning.envs.base import Expert


def expert_record(expert: Expert) -> dict[str, Any]:
    """Class and settings of an expert, ``{class_path, init_args}``, as JSON can hold them."""
    # Paths are told as text; of other objects, whose text may hold an address, only the type is known again.
    text = json.dumps(
        blueprint(expert), default=lambda value: str(value) if hasattr(value, "__fspath__") else str(type(value))
    )
    plain: dict[str, Any] = json.loads(text)
    return plain


def expert_differences(expert: Expert, record: object) -> dict[str, tuple[object, object]]:
    """Settings in which an expert in a file's record differs from this one: (its own, ours), by ``.setting``.

    The class itself is called ''. It is compared by its name, as modules move; older files hold no more than that.
    Settings that the record lacks had their defaults, and those that no expert has any more are left aside.
    """
    ours = expert_record(expert)
    known = record if isinstance(record, Mapping) else {"class_path": record}
    names = [str(told.get("class_path")).rpartition(".")[2] for told in (known, ours)]
    if names[0] != names[1]:
        return {"": (names[0], names[1])}
    if not isinstance(record, Mapping):
        return {}
    theirs = _defaults(expert) | dict(record.get("init_args", {}))
    pairs = {f".{name}": (theirs.get(name, value), value) for name, value in ours["init_args"].items()}
    return {name: (found, own) for name, (found, own) in pairs.items() if found != own}


def _defaults(expert: Expert) -> dict[str, Any]:
    parameters = inspect.signature(type(expert)).parameters.values()
    return {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}
