"""jsonargparse's complaints, which fill a screen, in one line: key, what was found, what was expected, what to do."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Callable, Iterable

from jsonargparse import ArgumentParser

from plp_lightning.cli.classes import known_classes

NEAR = 0.7  # Similarity from which a known word is offered in place of an unknown one


def explain(message: str, parser: ArgumentParser) -> str:
    """One line for a complaint of ``parser``."""
    place = ".".join(re.findall(r'Parser key "([^"]+)"', message)) or "the configuration"
    for pattern, tell in COMPLAINTS:
        found = re.search(pattern, message)
        if found:
            return tell(place, found, parser)
    return f"{' '.join(message.split())[:300]}; see plp fit --help"


def _forbidden(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    name = found[1]
    return (
        f"{place}: importing {name!r} is not allowed; expected a class of this project; "
        f"if you trust it, add --allow_imports {name.split('.')[0]}"
    )


def _unknown_key(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    name = found[1] if len(found.groups()) == 1 else f"{found[1]}.{found[2]}"
    full = name if place == "the configuration" else f"{place}.{name}"
    known = _known_words(parser) | set(place.split("."))
    return f"unknown key {full!r}; " + _hint(full, known, "see plp fit --help")


def _unknown_class(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    names = [kind.__name__ for kind in known_classes()]
    return f"{place}: unknown class {found[1]!r}; " + _hint(found[1], names, "expected a class or its import path")


def _wrong_type(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    expected = re.sub(r"<class '([\w.]+)'>|typing\.", r"\1", found[1])
    return f"{place} is {found[2]}; expected {expected}; mend the value"


def _out_of_bounds(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    return f"{place} is {found[1]}; change it"


def _no_experiment(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    return f"{found[1]} not set; give an experiment, such as --config configs/r2r.yaml"


COMPLAINTS: list[tuple[str, Callable[[str, re.Match[str], ArgumentParser], str]]] = [
    (r"Importing '([^']+)' is not allowed", _forbidden),
    (r"Option '([^']+)' is not accepted", _unknown_key),
    (r"Group '([^']+)' does not accept option '([^']+)'", _unknown_key),
    (r"unrecognized arguments: (?:--)?([^\s=]+)", _unknown_key),
    (r"Expected a dot import path string: (\S+)", _unknown_class),
    (r"Not of type \w+: (.+?; expected [^\n|]+?)(?:\. Got value|\n|$)", _out_of_bounds),
    (r"Expected an? (.+?)\. Got value: (.+?)(?:\. Got value|\n|$)", _wrong_type),
    (r"Subtypes: \[([^\n]+)\][\s\S]*Given value: (.+?)(?:\. Got value|\n|$)", _wrong_type),
    (r"arguments are required: (.+)", _no_experiment),
]
"""What jsonargparse says, most telling first, and how to tell it."""


def _hint(name: str, known: Iterable[str], otherwise: str) -> str:
    """``name`` with its first unknown word replaced by the nearest known one."""
    known = set(known)
    wrong = next((word for word in name.split(".") if word not in known), "")
    near = difflib.get_close_matches(wrong, sorted(known), n=1, cutoff=NEAR)
    return f"did you mean {name.replace(wrong, near[0])!r}?" if near else otherwise


def _known_words(parser: ArgumentParser) -> set[str]:
    keys = {word for action in parser._actions for word in action.dest.split(".")}
    arguments = {name for kind in known_classes() for name in inspect.signature(kind).parameters}
    return keys | arguments | {"init_args", "class_path"}
