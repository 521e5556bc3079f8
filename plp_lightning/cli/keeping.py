"""The configuration that a run keeps: plain data, which is read again as the same settings."""

from __future__ import annotations

import json
from argparse import ArgumentError
from collections.abc import Sequence
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

from jsonargparse import ArgumentParser, Namespace

from datamodules.errors import ConfigError
from datamodules.plain_yaml import dump_yaml
from plp_lightning.cli.classes import ALLOWED_IMPORTS, defaults, find_class
from plp_lightning.cli.layers import insert
from plp_lightning.cli.yaml_files import Tree


def keep(parser: ArgumentParser, config: Namespace, dropped: Sequence[str]) -> Tree:
    """A parsed configuration as plain data.

    Objects that are defaults of classes, which no file could hold, are left to those classes; ``dropped`` keys are
    null.

    Raises:
        ConfigError: If it would not be read again as the same settings.
    """
    kept = _plain(parser, config)
    try:
        again = _read_again(parser, dump_yaml(kept))
    except ArgumentError as error:
        raise ConfigError(f"the configuration can't be kept, for it is not read again: {error}") from None
    if not _is_same(config, again) and (changed := first_change(kept, _plain(parser, again))):
        raise ConfigError(f"{changed} can't be kept in a file; expected plain data there: leave it away")
    for key in dropped:
        insert(kept, key, None)
    return kept


@lru_cache(maxsize=8)
def _read_again(parser: ArgumentParser, text: str) -> Namespace:
    """The settings that a parser reads in a text; looking at a run several times asks for the same."""
    read: Namespace = parser.parse_args(["--config", text])
    return read


def _is_same(one: Any, other: Any) -> bool:
    """Tell whether two parsed configurations are alike to the last type; if not, they may still be kept as the same."""
    if isinstance(one, Namespace) and isinstance(other, Namespace):
        return _is_same({**vars(one), "config": None}, {**vars(other), "config": None})
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return [*one] == [*other] and all(map(_is_same, one.values(), other.values()))
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_is_same, one, other))
    return one is other or (isinstance(one, bool | int | float | str) and repr(one) == repr(other))


def _plain(parser: ArgumentParser, config: Namespace) -> Tree:
    copied = config.clone()
    _drop_objects(copied)
    try:
        tree: Tree = json.loads(parser.dump(copied, format="json", skip_unset=False, skip_validation=True))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"the configuration holds what no file can ({error}); leave it away") from None
    return tree


def _drop_objects(value: Any) -> None:
    """Take away settings that are objects and defaults of their classes."""
    parts = vars(value) if isinstance(value, Namespace) else value
    if isinstance(parts, dict) and isinstance(parts.get("init_args"), Namespace):
        kind = find_class(str(parts.get("class_path")), ALLOWED_IMPORTS)
        said: dict[str, Any] = parts["init_args"].__dict__
        own = defaults(kind) if kind is not None else {}
        for name in [name for name, x in said.items() if not _may_stand(x) and x == own.get(name)]:
            del said[name]
    for part in parts.values() if isinstance(parts, dict) else parts if isinstance(parts, list) else ():
        _drop_objects(part)


def _may_stand(value: Any) -> bool:
    plain = (type(None), bool, int, float, str, list, tuple, dict, Namespace, Path)
    return (isinstance(value, plain) and not isinstance(value, Enum)) or callable(value)


def first_change(one: Any, other: Any, place: str = "") -> str:
    """Dotted key of the first setting that differs, or that only one has; empty if none does."""
    if isinstance(one, dict) and isinstance(other, dict):
        keys = {**one, **other}
        found = (first_change(one.get(key, keys), other.get(key, keys), f"{place}.{key}") for key in keys)
        return next(filter(None, found), "")
    return "" if repr(one) == repr(other) else place.lstrip(".")
