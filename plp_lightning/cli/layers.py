"""Configuration files laid over one another: classes are chosen before any default is filled in.

A later file wins, key by key. Where it changes a class, it keeps what earlier files said about settings that the new
class has too, and nothing else: no default of the class before. So pages can set up an experiment for every method.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any

from datamodules.errors import ConfigError
from plp_lightning.cli.classes import defaults, find_class
from plp_lightning.cli.yaml_files import Tree

GROUPS = ("domains", "data", "collection", "handover", "evaluation", "trainer")
"""Keys that hold settings and are no objects."""
OBJECT = ("class_path", "init_args", "dict_kwargs")
"""Keys of an object."""


def check_shape(tree: Any, place: str = "") -> None:
    """Refuse, by a :class:`ConfigError`, a group or an object's settings that are no keys and values."""
    if isinstance(tree, list):
        for item in tree:
            check_shape(item, place)
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        name = f"{place}.{key}".lstrip(".")
        if (key == "init_args" or name in GROUPS) and not isinstance(value, Mapping):
            raise ConfigError(f"{name} is {value!r}; expected keys and values: mend it or leave it away")
        if place == "domains" and not isinstance(value, Mapping):
            raise ConfigError(f"{name} is {value!r}; expected simulator and expert, or {{}} where there is neither")
        if key == "class_path" and not isinstance(value, str):
            raise ConfigError(f"{name} is {value!r}; expected a class or its import path: mend it")
        check_shape(value, name)


def overlay(below: Any, above: Any, allowed: Sequence[str]) -> Any:
    """Lay one configuration, or a part of it, over another, which is left as it is.

    A key that ends in ``+`` appends to a list. Only classes of the ``allowed`` packages are imported.

    Raises:
        ConfigError: If ``below`` sets up a class with a setting that it doesn't have.
    """
    if isinstance(above, str) and isinstance(below, Mapping) and below.keys() & {"class_path", "init_args"}:
        above = {"class_path": above}
    if not isinstance(below, Mapping) or not isinstance(above, Mapping):
        return above
    classes = [part["class_path"] for part in (below, above) if "class_path" in part]
    merged = _other_class(below, above, allowed) if len(classes) == 2 and len({*classes}) == 2 else dict(below)
    for key, value in above.items():
        if isinstance(key, str) and key.endswith("+"):
            name = key[:-1]
            merged[name] = [*(merged.get(name) or []), *(value if isinstance(value, list) else [value])]
        else:
            merged[key] = overlay(merged.get(key), value, allowed)
    return merged


def _other_class(below: Mapping[str, Any], above: Mapping[str, Any], allowed: Sequence[str]) -> Tree:
    """A part of a configuration without the settings that its new class doesn't have."""
    old, new = (find_class(str(part["class_path"]), allowed) for part in (below, above))
    said = below.get("init_args") or {}
    unknown = [name for name in said if old is not None and name not in defaults(old)]
    if unknown:
        raise ConfigError(f"unknown key {unknown[0]!r} of {below['class_path']}; see plp fit --help")
    return {**below, "init_args": {name: x for name, x in said.items() if new is None or name in defaults(new)}}


def completed(tree: Any, allowed: Sequence[str], place: str = "") -> Any:
    """A configuration, or the part of it at ``place``, with every class's own defaults for settings that were left out.

    The parser would fill in the defaults of whatever class stood there before.

    Raises:
        ConfigError: If a setting stands beside a class.
    """
    if isinstance(tree, list):
        return [completed(item, allowed, place) for item in tree]
    if not isinstance(tree, Mapping):
        return tree
    inner = {key: completed(value, allowed, f"{place}.{key}".lstrip(".")) for key, value in tree.items()}
    if "class_path" in tree and (stray := [key for key in tree if key not in OBJECT]):
        told = f"{place}.{stray[0]} stands beside the class {tree['class_path']}"
        raise ConfigError(f"{told}; expected its settings below init_args: {place}.init_args.{stray[0]}")
    kind = find_class(str(tree["class_path"]), allowed) if "class_path" in tree else None
    if kind is None:
        return inner
    own = {name: _as_yaml(value) for name, value in defaults(kind).items() if _is_plain(value)}
    arguments = {**own, **(inner.get("init_args") or {})}
    return {**inner, "init_args": arguments} if arguments else inner


def _is_plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    plain = value is None or (isinstance(value, bool | int | float | str) and not isinstance(value, Enum))
    return plain or dataclasses.is_dataclass(value)


def _as_yaml(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: _as_yaml(item) for name, item in dataclasses.asdict(value).items()}
    return [_as_yaml(item) for item in value] if isinstance(value, list | tuple) else value


def without_spare_parts(tree: Tree, phases: Sequence[str], terms: Sequence[str]) -> tuple[Tree, list[str]]:
    """Leave away the phases and terms that files set up and the method does not choose.

    Args:
        tree: The whole configuration.
        phases: Names of all phases that files set up.
        terms: Names of terms that pages may set up without choosing them; others need a class.

    Returns:
        The configuration, and dotted keys of terms that were left away.
    """
    kept = copy.deepcopy({key: value for key, value in tree.items() if key not in phases or key in tree["phases"]})
    dropped = []
    for phase in tree["phases"]:
        chosen = ((kept.get(phase) or {}).get("init_args") or {}).get("terms") or {}
        if not isinstance(chosen, dict):
            raise ConfigError(f"{phase}.terms is {chosen!r}; expected names, each with a class: mend it")
        for name, term in [*chosen.items()]:
            if not isinstance(term, dict | None) or "class_path" in (term or {}):
                continue  # which the parser looks at
            if term is not None and name not in terms:
                place, known = f"{phase}.terms.{name}", ", ".join(terms)
                raise ConfigError(f"{place} has no class; give its class_path, or name one of: {known}")
            del chosen[name]
            dropped.append(f"{phase}.init_args.terms.{name}")
    return kept, dropped


def with_encoder_class(tree: Tree, below: Tree) -> Tree:
    """A configuration whose image encoder has a class, where a page states its settings alone.

    It is the class that the configuration ``below`` has, or else ours.
    """
    said, known = (_encoder(part) for part in (tree, below))
    if not isinstance(said, Mapping) or said.keys() & {"class_path", "init_args"}:
        return tree
    kind = known.get("class_path") if isinstance(known, Mapping) else None
    given = {"class_path": kind or "ImageEncoding", "init_args": dict(said)}
    policy = tree["policy"]
    return {**tree, "policy": {**policy, "init_args": {**policy["init_args"], "image_encoder": given}}}


def _encoder(tree: Tree) -> Any:
    policy = tree.get("policy")
    settings = policy.get("init_args") if isinstance(policy, Mapping) else None
    return settings.get("image_encoder") if isinstance(settings, Mapping) else None


def insert(tree: Tree, key: str, value: Any) -> None:
    """Set a dotted key."""
    *path, name = key.split(".")
    for part in path:
        tree = tree.setdefault(part, {})
    tree[name] = value
