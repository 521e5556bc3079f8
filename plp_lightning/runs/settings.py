"""Settings of a run: which of them differ from the defaults, and a hash of them all."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import torch
from lightning.pytorch import Trainer
from torch.nn import Parameter
from torch.optim import Optimizer

from datamodules.amounts import DataSettings
from datamodules.settings import Configured
from plp_lightning.runs.plans import CollectionConfig, EvaluationPlan, HandoverPlan

GROUPS: dict[str, type] = {
    "data": DataSettings,
    "collection": CollectionConfig,
    "handover": HandoverPlan,
    "evaluation": EvaluationPlan,
    "trainer": Trainer,
}
"""Classes behind the keys that name none."""
PLACES = ("run_root", "data.root", "data.file", "recipe", "sweep")
"""Keys that say where something lies, or whose part it is, not what it is."""
IDENTITY = ("experiment", "method", "data.target_task", "seed", "allow_imports")
"""Keys that results hold under names of their own, and whose code may be run."""
UNKNOWN = object()  # Stands for the default of what has none; nothing equals it


def differing_settings(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """Finds the settings of a resolved configuration that are not as the classes' signatures have them.

    Returns:
        Values by dotted key, ``init_args`` left out of the keys, such as ``{"alignment.lr": 0.001}``. An object's own
        key holds the name of its class. What has no default is there if it is set, places and :data:`IDENTITY` never.
    """
    found: dict[str, Any] = {}
    for key, value in resolved.items():
        found |= _differing(key, value, _defaults(GROUPS[key]) if key in GROUPS else UNKNOWN)
    named = {key: value for key, value in found.items() if key not in (*PLACES, *IDENTITY)}
    return {key: value for key, value in named.items() if not key.startswith("trainer.logger")}


def config_hash(resolved: Mapping[str, Any]) -> str:
    """SHA-256 of a resolved configuration without the places that it names, in hexadecimal digits."""
    return hashlib.sha256(json.dumps(without_places(resolved), sort_keys=True, default=str).encode()).hexdigest()


def without_places(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved configuration without the places that it names, those that curves are logged to included."""
    data = {key: value for key, value in resolved.get("data", {}).items() if f"data.{key}" not in PLACES}
    trainer = {key: value for key, value in resolved.get("trainer", {}).items() if key != "logger"}
    own = {"data": data} | ({"trainer": trainer} if "trainer" in resolved else {})
    return {key: value for key, value in resolved.items() if key not in PLACES} | own


def with_defaults(resolved: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved configuration with the defaults of settings of groups that it is older than."""
    known = {key: {**_defaults(made), **resolved.get(key, {})} for key, made in GROUPS.items()}
    return {**resolved, **known}


def _differing(key: str, value: Any, default: Any) -> dict[str, Any]:
    if value == default or (default is UNKNOWN and value in (None, [])):
        return {}
    if isinstance(value, Mapping) and "class_path" in value:
        made, expected = _class(value["class_path"]), _expected(default)
        name = {} if made in (expected, type(expected)) else {key: str(value["class_path"]).rsplit(".", 1)[-1]}
        own = expected.arguments if isinstance(expected, Configured) and not name else {}
        defaults = {**_defaults(made), **{argument: _plain(number) for argument, number in own.items()}}
        return name | _parts(key, value.get("init_args") or {}, defaults)
    if isinstance(value, Mapping):
        return _parts(key, value, default if isinstance(default, Mapping) else {})
    if isinstance(value, list) and any(isinstance(part, Mapping) for part in value):
        return _parts(key, {str(i): part for i, part in enumerate(value)}, {})
    return {key: value}


def _parts(key: str, values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= _differing(f"{key}.{name}", value, defaults.get(name, UNKNOWN))
    return found


def _expected(default: Any) -> Any:
    """The object that stands behind a default: a signature may have a factory of it."""
    factory = isinstance(default, FunctionType) or (isinstance(default, type) and issubclass(default, Optimizer))
    return default([Parameter(torch.zeros(1))]) if factory else default


def _class(path: str) -> Any:
    """The class that a configuration names, which was imported when it was read; None if it is gone."""
    module, _, name = path.rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError):
        return None


def _defaults(made: Any) -> dict[str, Any]:
    """Defaults of a class's arguments, as a configuration writes them."""
    parameters = inspect.signature(made).parameters.values() if callable(made) else ()
    return {p.name: _plain(p.default) for p in parameters if p.default is not p.empty}


def _plain(default: Any) -> Any:
    """A default as YAML would hold it: tuples are lists, paths words; objects stay as they are."""
    if isinstance(default, Configured):
        return default
    if isinstance(default, Mapping):
        return {key: _plain(value) for key, value in default.items()}
    if isinstance(default, list | tuple):
        return [_plain(value) for value in default]
    return str(default) if isinstance(default, Path) else default
