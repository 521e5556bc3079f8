"""YAML as plain data: words, numbers, lists and mappings, from text that anyone may have written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from datamodules.words import CONTROL, expand_home

MOST = 100_000  # Values in a text, those behind aliases counted wherever they are used
DEEPEST = 50  # Levels of lists and mappings within one another
TAG = "tag:yaml.org,2002:"
SCALARS = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF", list("yYnNtTfFoO")),
    # Whole numbers are decimal: no times of day, which YAML 1.1 takes for numbers of base 60, nor endless ones.
    "int": (r"[-+]?(?:0|[1-9][0-9_]{0,300})", list("-+0123456789")),
    "float": (
        r"[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+|\.[0-9_]+(?:[eE][-+]?[0-9]+)?)"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        list("-+0123456789."),
    ),
    "merge": ("<<", ["<"]),
}
"""What words mean that no quotes say to be words: a pattern, and the letters that they begin with."""
KEYS = {f"{TAG}{kind}" for kind in ("str", "int", "merge")}


class _Reader(yaml.SafeLoader):
    """Makes plain data alone: no dates, no sets, no bytes, no numbers of base 60."""


class _Writer(yaml.SafeDumper):
    """Puts quotes around what one of the readers would take for a number."""


_plain = ("null", "bool", "int", "float", "str", "seq", "map")
_Reader.yaml_constructors = {f"{TAG}{kind}": yaml.SafeLoader.yaml_constructors[f"{TAG}{kind}"] for kind in _plain}
_Reader.yaml_constructors[None] = yaml.SafeLoader.yaml_constructors[None]
_Reader.yaml_implicit_resolvers = {}
for _kind, (_pattern, _first) in SCALARS.items():
    _Reader.add_implicit_resolver(f"{TAG}{_kind}", re.compile(f"(?:{_pattern})$"), _first)
_Writer.add_implicit_resolver(f"{TAG}float", re.compile(f"(?:{SCALARS['float'][0]})$"), SCALARS["float"][1])


def _word(reader: yaml.SafeLoader, node: yaml.ScalarNode) -> str:
    text = str(reader.construct_scalar(node))
    if CONTROL.search(text):
        raise yaml.YAMLError(f"{text[:40]!r} holds a control character, {_line(node)}")
    return expand_home(text)


_Reader.add_constructor(f"{TAG}str", _word)


def parse_yaml(text: str) -> Any:
    """Plain data of a YAML text; words that begin with ``~/`` are paths below the home folder.

    Raises:
        yaml.YAMLError: If the text is no YAML, states a key twice, or holds anything but plain data, or too much of it:
            aliases can stand for more values than any memory holds.
    """
    reader = _Reader(text)
    try:
        node = reader.get_single_node()
        if node is None:
            return None
        count, depth = _measure(node, {})
        if count > MOST or depth > DEEPEST:
            raise yaml.YAMLError(f"{count:.3g} values, {depth} levels; more than {MOST} or {DEEPEST}")
        return reader.construct_document(node)
    except RecursionError:
        raise yaml.YAMLError(f"more than {DEEPEST} levels") from None
    finally:
        reader.dispose()


def dump_yaml(data: Any) -> str:
    """Plain data as YAML in block style, keys in their order, which :func:`parse_yaml` reads as the same data."""
    return str(yaml.dump(data, Dumper=_Writer, sort_keys=False))


def _measure(node: yaml.Node, known: dict[int, tuple[float, int] | None]) -> tuple[float, int]:
    """Count the values that a node stands for, and its levels, with aliases written out, before anyone does that."""
    if id(node) not in known:
        known[id(node)] = None  # until its parts are known; whoever meets it before is one of them
        found = [_measure(part, known) for part in _parts(node)]
        known[id(node)] = 1.0 + sum(count for count, _ in found), 1 + max((depth for _, depth in found), default=0)
    measured = known[id(node)]
    if measured is None:
        raise yaml.YAMLError(f"an alias stands for what it is a part of, {_line(node)}")
    return measured


def _parts(node: yaml.Node) -> Iterator[yaml.Node]:
    if isinstance(node, yaml.SequenceNode):
        yield from node.value
    elif isinstance(node, yaml.MappingNode):
        _check_keys(node)
        yield from (part for pair in node.value for part in pair)


def _check_keys(node: yaml.MappingNode) -> None:
    found = set()
    for key, _ in node.value:
        if key.tag not in KEYS:
            raise yaml.YAMLError(f"a key is no word; put it in quotes, {_line(key)}")
        if key.value in found:
            raise yaml.YAMLError(f"{key.value[:40]!r} is set twice, {_line(key)}")
        found.add(key.value)


def _line(node: yaml.Node) -> str:
    return f"line {node.start_mark.line + 1}"
