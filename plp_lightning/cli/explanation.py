"""jsonargparse's complaints, which fill a screen, in one line: key, what was found, what was expected, what to do."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Callable, Iterable

from jsonargparse import ArgumentParser

from plp_lightning.cli.classes import known_classes

GIVE = "give an experiment, such as --config configs/r2r.yaml"
OURS = {
    "trainer.callbacks": "a run has its own: append yours with --callbacks+=CLASS",
    "trainer.default_root_dir": "everything is in the run directory: choose where with --run_root",
    "trainer.plugins": "a run has its own: leave it away",
    "trainer.enable_checkpointing": "a run always saves where it stands: leave it away",
    "trainer.enable_progress_bar": "a run shows its progress in its own way: leave it away",
}
"""Arguments of Lightning's Trainer that a run sets itself, and what to do instead."""
PLAIN = (
    (r"<class '([\w.]+)'>", r"\1"),
    (r"import path or a subclass spec.*", "a class"),
    (r"[\w.]*\bCallable\[\[[^\]]*\], ([\w.]+)(?:\[[^\]]*\])?\]", r"\1"),
    (r"(?:\w+\.)+(\w+)", r"\1"),
    (r", NoneType\b", " or null"),
    (r"\bstr\b", "text"),
)
"""What jsonargparse says of types, and how a page's author would."""
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
    trust = f"expected a class of this project; if you trust it, add --allow_imports {found[1].split('.')[0]}"
    return f"{place}: importing {found[1]!r} is not allowed; {trust}"


def _stray_word(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    return f"{found[1]!r} belongs to no option; expected --config FILE and options: name one before it or leave it away"


def _unknown_key(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    full = ".".join([*([] if place == "the configuration" else [place]), *found.groups()])
    if full in OURS:
        return f"{full} is not for files and flags to set; {OURS[full]}"
    known, words = _known_words(parser) | set(place.split(".")), full.split(".")
    first = next((i for i, word in enumerate(words) if word not in known), len(words))
    full = ".".join(words[: first + 1])  # below an unknown key nothing is known
    return f"unknown key {full!r}; " + _hint(full, known, "see plp fit --help")


def _unknown_class(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    names, name = [kind.__name__ for kind in known_classes()], found[1].rstrip(".")
    return f"{place}: unknown class {name!r}; " + _hint(name, names, "expected a class or its import path")


def _wrong_type(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    return f"{place} is {found[2]}; expected {_plain(found[1])}; mend the value"


def _plain(types: str) -> str:
    """Types as a page's author knows them: classes by their short names."""
    for pattern, word in PLAIN:
        types = re.sub(pattern, word, types)
    return types


def _lacking(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    return f"{place} is a {found[1]} without {found[2]}; expected all that it needs: set {found[2]}"


def _not_set(place: str, found: re.Match[str], parser: ArgumentParser) -> str:
    names = found[1].split(", ")
    return f"{found[1]} not set; {GIVE if len(names) > 1 else f'set it on the page, or by --{names[0]} VALUE'}"


COMPLAINTS: list[tuple[str, Callable[[str, re.Match[str], ArgumentParser], str]]] = [
    (r"Importing '([^']+)' is not allowed", _forbidden),
    (r"Option '([^']+)' is not accepted", _unknown_key),
    (r"Group '([^']+)' does not accept option '([^']+)'", _unknown_key),
    (r"unrecognized arguments: --([^\s=]+)", _unknown_key),
    (r"unrecognized arguments: (.+)", _stray_word),
    (r"Expected a dot import path string: (\S+)", _unknown_class),
    (r"Not of type \w+: (.+?; expected [^\n|]+?)(?:\. Got value|\n|$)", lambda at, x, _: f"{at} is {x[1]}; change it"),
    (r"Expected an? (.+?)\. Got value: (.+?)(?:\. Got value|\n|$)", _wrong_type),
    (r"Not a valid subclass of (\w+)\. Got value: (.+?)\n", _wrong_type),
    (r"given class_path '[\w.]*?(\w+)':\s+the following arguments are required: (.+)", _lacking),
    (r"Subtypes: \[([^\n]+)\](?:(?!Subtypes)[\s\S])*?Given value: (.+?)(?:\. Got value|\n|$)", _wrong_type),
    (r"arguments are required: (.+)", _not_set),
]
"""What jsonargparse says, most telling first, and how to tell it."""


def _hint(name: str, known: Iterable[str], otherwise: str) -> str:
    """``name`` with its first unknown word, or else its last, replaced by the nearest other one that is known."""
    known, words = set(known), name.split(".")
    wrong = next((word for word in words if word not in known), words[-1])
    near = difflib.get_close_matches(wrong, sorted(known - {wrong}), n=1, cutoff=NEAR)
    return f"did you mean {name.replace(wrong, near[0])!r}?" if near else otherwise


def _known_words(parser: ArgumentParser) -> set[str]:
    keys = {word for action in parser._actions for word in action.dest.split(".")}
    arguments = {name for kind in known_classes() for name in inspect.signature(kind).parameters}
    return keys | arguments | {"init_args", "class_path"}
