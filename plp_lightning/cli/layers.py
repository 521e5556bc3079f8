"""Configuration files laid over one another: classes are chosen before any default is filled in.

A later file wins, key by key. Where it changes a class, it keeps what earlier files said about settings that the new
class has too, and nothing else: no default of the class before. So pages can set up an experiment for every method.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from datamodules.errors import ConfigError
from plp_lightning.cli.classes import defaults, find_class

Tree = dict[str, Any]
"""A configuration as YAML has it."""


def read_yaml(path: Path) -> Tree:
    """Keys and values of a file.

    Raises:
        ConfigError: If it can't be read or holds something else.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror}); name an existing YAML file") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: is no YAML ({' '.join(str(error).split())}); mend the file") from None
    if content is not None and not isinstance(content, dict):
        raise ConfigError(f"{path}: holds a {type(content).__name__}; expected keys and values, as in configs/r2r.yaml")
    return content or {}


def overlay(below: Any, above: Any, allowed: Sequence[str]) -> Any:
    """Lay one configuration, or a part of it, over another.

    Args:
        below: What earlier files say; left as it is.
        above: What a later file says. A key that ends in ``+`` appends to a list.
        allowed: Packages whose classes may be imported.

    Raises:
        ConfigError: If ``below`` sets up a class with a setting that it doesn't have.
    """
    if isinstance(above, str) and isinstance(below, Mapping) and below.keys() & {"class_path", "init_args"}:
        above = {"class_path": above}
    if not isinstance(below, Mapping) or not isinstance(above, Mapping):
        return above
    merged = _other_class(below, above, allowed) if changes_class(below, above) else dict(below)
    for key, value in above.items():
        if key.endswith("+"):
            name = key[:-1]
            merged[name] = [*(merged.get(name) or []), *(value if isinstance(value, list) else [value])]
        else:
            merged[key] = overlay(merged.get(key), value, allowed)
    return merged


def changes_class(below: Mapping[str, Any], above: Mapping[str, Any]) -> bool:
    """Whether a part of a configuration is of another class above than below."""
    return "class_path" in below and "class_path" in above and below["class_path"] != above["class_path"]


def _other_class(below: Mapping[str, Any], above: Mapping[str, Any], allowed: Sequence[str]) -> Tree:
    """A part of a configuration without the settings that its new class doesn't have."""
    old, new = (find_class(str(part["class_path"]), allowed) for part in (below, above))
    said = below.get("init_args") or {}
    unknown = [name for name in said if old is not None and name not in defaults(old)]
    if unknown:
        raise ConfigError(f"unknown key {unknown[0]!r} of {below['class_path']}; see plp fit --help")
    return {**below, "init_args": {name: x for name, x in said.items() if new is None or name in defaults(new)}}


def completed(tree: Any, allowed: Sequence[str]) -> Any:
    """The configuration with every class's own defaults in the place of what was left out.

    The parser would fill in the defaults of whatever class stood there before.

    Args:
        tree: A configuration, or a part of it.
        allowed: Packages whose classes may be imported.
    """
    if isinstance(tree, list):
        return [completed(item, allowed) for item in tree]
    if not isinstance(tree, Mapping):
        return tree
    inner = {key: completed(value, allowed) for key, value in tree.items()}
    kind = find_class(str(tree["class_path"]), allowed) if "class_path" in tree else None
    if kind is None:
        return inner
    own = {name: _as_yaml(value) for name, value in defaults(kind).items() if _is_plain(value)}
    arguments = {**own, **(inner.get("init_args") or {})}
    return {**inner, "init_args": arguments} if arguments else inner


def _is_plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str) or dataclasses.is_dataclass(value)


def _as_yaml(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: _as_yaml(item) for name, item in dataclasses.asdict(value).items()}
    return [_as_yaml(item) for item in value] if isinstance(value, list | tuple) else value


def without_spare_parts(tree: Tree, phases: Sequence[str], terms: Sequence[str]) -> tuple[Tree, list[str]]:
    """Leave away what files set up and the method does not choose.

    Args:
        tree: The whole configuration.
        phases: Names of all phases that files set up.
        terms: Names of terms that pages may set up without choosing them.

    Returns:
        The configuration, and dotted keys of terms that were left away.

    Raises:
        ConfigError: If a term without a class has another name.
    """
    kept = {key: value for key, value in tree.items() if key not in phases or key in tree["phases"]}
    dropped = []
    for phase in tree["phases"]:
        settings = (kept.get(phase) or {}).get("init_args") or {}
        for name, term in (settings.get("terms") or {}).items():
            if not isinstance(term, str) and "class_path" not in (term or {}):
                _check_spare(f"{phase}.terms.{name}", name, term, terms)
                dropped.append(f"{phase}.init_args.terms.{name}")
    return remove(kept, dropped), dropped


def _check_spare(place: str, name: str, term: Any, known: Sequence[str]) -> None:
    if term is not None and name not in known:
        raise ConfigError(f"{place} has no class; give its class_path, or name one of: {', '.join(known)}")


def remove(tree: Tree, keys: Sequence[str]) -> Tree:
    """The configuration without some dotted keys."""
    kept = dict(tree)
    for key in keys:
        head, _, rest = key.partition(".")
        if rest and isinstance(kept.get(head), Mapping):
            kept[head] = remove(kept[head], [rest])
        elif not rest:
            kept.pop(head, None)
    return kept


def insert(tree: Tree, key: str, value: Any) -> None:
    """Set a dotted key."""
    *path, name = key.split(".")
    for part in path:
        tree = tree.setdefault(part, {})
    tree[name] = value


def is_required(default: Any) -> bool:
    """Whether a setting has no default."""
    return default is inspect.Parameter.empty
