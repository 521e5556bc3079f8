"""Types of signatures → JSON Schema: bounds, words, lists, and classes with the settings that each one has."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import enum
import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from jsonargparse import ArgumentParser

from datamodules.settings import BOUNDS
from plp_lightning.cli.classes import ROOTS, known_classes

Schema = dict[str, Any]
PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", Path: "string", NoneType: "null"}
IMPORT_PATH = r"^[A-Za-z_]\w*(\.\w+)+$"


class Definitions:
    """Schemas of classes, each made once, in ``made``, and referred to by name."""

    def __init__(self) -> None:
        self.made: dict[str, Schema] = {}

    def keys(self, parser: ArgumentParser) -> Schema:
        """Schema of the keys of a parser; none is required."""
        whole = _object()
        for action in parser._actions:
            if hasattr(action, "_typehint") and action.dest.rpartition(".")[2] != "help":
                *groups, name = action.dest.split(".")
                group = whole
                for key in groups:
                    group = group["properties"].setdefault(key, _object())
                group["properties"] |= dict(self._key(name, action))
        return whole

    def _key(self, name: str, action: argparse.Action) -> Iterator[tuple[str, Schema]]:
        """A key, and the one that appends if it holds a list."""
        made = self.schema(action._typehint)  # type: ignore[attr-defined]
        about: Schema = {"description": " ".join(action.help.split())} if action.help else {}
        yield name, {**made, **about, **_default(action.default)}
        if lists := [part for part in made.get("anyOf", [made]) if part.get("type") == "array"]:
            yield f"{name}+", {"anyOf": [*lists, *(part["items"] for part in lists if "items" in part)], **about}

    def schema(self, hint: Any) -> Schema:
        """Schema of values of a type; of any values if the type is none that YAML could hold."""
        origin, parts = get_origin(hint), get_args(hint)
        if hint in BOUNDS:
            return {"type": PLAIN[BOUNDS[hint].kind], **BOUNDS[hint].limits}
        if hint in PLAIN:
            return {"type": PLAIN[hint]}
        if origin is Literal:
            return {"enum": list(parts)}
        if origin in (Union, UnionType):
            return {"anyOf": [self.schema(part) for part in parts]}
        if origin is Callable:
            return self._object_of(parts[1], len(parts[0])) if parts and isinstance(parts[0], list) else {}
        return self._collection(origin, parts) if origin is not None and parts else self._object_of(hint)

    def _collection(self, origin: Any, parts: Sequence[Any]) -> Schema:
        if not isinstance(origin, type) or not issubclass(origin, Mapping | Sequence):
            return self._object_of(origin)
        if issubclass(origin, Mapping):
            item = self.schema(parts[-1])
            null = [{"type": "null"}] if "$ref" in item else []  # which leaves an object of a page below away
            return {"type": "object", "additionalProperties": {"anyOf": [item, *null]} if null else item}
        if issubclass(origin, tuple) and parts[-1] is not Ellipsis:
            items = [self.schema(part) for part in parts]
            return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}
        return {"type": "array", "items": self.schema(parts[0])}

    def _object_of(self, kind: Any, given: int = 0) -> Schema:
        """An object that a page describes, ``given`` of whose first arguments come from elsewhere."""
        kind = get_origin(kind) or kind
        if not isinstance(kind, type):
            return {}
        if issubclass(kind, enum.Enum):
            return {"enum": [*kind.__members__]}
        if kind in ROOTS or any(issubclass(kind, root) for root in ROOTS):
            return self._named(kind.__name__, lambda: self._choice(kind, given))
        return self._settings(kind, given) if dataclasses.is_dataclass(kind) else {}

    def _choice(self, root: type, given: int) -> Schema:
        """A class of those below ``root``: its name, or name and settings."""
        kinds = sorted({*known_classes([root])}, key=lambda kind: kind.__name__)
        kinds = [kind for kind in kinds if not inspect.isabstract(kind) and not kind.__name__.startswith("_")]
        settings = [self._settings(kind, given) for kind in kinds]
        names = self._named(f"name-of-{root.__name__}", lambda: _names(kinds))
        each = [
            {"if": _says(kind), "then": {"properties": {"init_args": own}}}
            for kind, own in zip(kinds, settings, strict=True)
        ]
        silent = {"properties": {"init_args": {"anyOf": settings}}}  # a page below names the class
        chosen = _object(class_path=names, init_args={"type": "object"}, dict_kwargs={"type": "object"})
        chosen["allOf"] = [*each, {"if": {"not": {"required": ["class_path"]}}, "then": silent}]
        return {"anyOf": [names, chosen, *(settings if dataclasses.is_dataclass(root) else [])]}

    def _settings(self, kind: type, given: int) -> Schema:
        """Settings of a class."""
        return self._named(f"settings-of-{kind.__module__}.{kind.__qualname__}", lambda: self._made(kind, given))

    def _made(self, kind: type, given: int) -> Schema:
        parser = ArgumentParser(exit_on_error=False)
        parser.add_class_arguments(kind, skip={*[*inspect.signature(kind).parameters][:given]})
        return {**self.keys(parser), "description": first_line(kind)}

    def _named(self, name: str, make: Callable[[], Schema]) -> Schema:
        if name not in self.made:
            self.made[name] = {}  # or a class that holds others of its kind would never end
            self.made[name] |= make()
        return {"$ref": f"#/$defs/{name}"}


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "additionalProperties": False, "properties": properties}


def _names(kinds: Sequence[type]) -> Schema:
    """Names of classes, and import paths of others."""
    told = [{"const": kind.__name__, "description": first_line(kind)} for kind in kinds]
    return {"anyOf": [*told, {"type": "string", "pattern": IMPORT_PATH}]}


def _says(kind: type) -> Schema:
    """True of what names this class."""
    names = [kind.__name__, f"{kind.__module__}.{kind.__qualname__}"]
    return {"required": ["class_path"], "properties": {"class_path": {"enum": names}}}


def first_line(kind: type) -> str:
    """The first line of a class's docstring."""
    return (inspect.getdoc(kind) or "").partition("\n")[0]


def _default(value: Any) -> Schema:
    """A default that JSON can hold; null often stands for what is decided later, and is left away."""
    with contextlib.suppress(TypeError, ValueError):
        return {"default": json.loads(json.dumps(value, allow_nan=False))} if value is not None else {}
    return {}
