"""Options of the verbs that need no configuration file, with mistakes told in one line."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Collection
from dataclasses import is_dataclass
from types import UnionType
from typing import Any, Literal, NoReturn, Union, get_args, get_origin, get_type_hints

from datamodules.errors import ConfigError


class OptionParser(argparse.ArgumentParser):
    """Raises where argparse would print its usage and leave."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; see {self.prog} --help")


class _Gather(argparse.Action):
    """Takes one value or more, and what is given again beside what was given before, in the place of the default."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        before = getattr(namespace, self.dest)  # the default is no list
        setattr(namespace, self.dest, [*(before if isinstance(before, list) else ()), *values])


def positive(text: str) -> int:
    """A count: a whole number of at least 1, up to a thousand million."""
    return _number(text, 1, 1_000_000_000, "at least 1")


def not_negative(text: str) -> int:
    """A count that may be 0, up to a thousand million."""
    return _number(text, 0, 1_000_000_000, "at least 0")


def seed(text: str) -> int:
    """A seed: a whole number that 32 bits hold."""
    return _number(text, 0, (1 << 32) - 1, f"from 0 to {(1 << 32) - 1}")


def pixels(text: str) -> int:
    """A height or a width of pictures: a whole number from 16 to 1024."""
    return _number(text, 16, 1024, "from 16 to 1024")


def _number(text: str, least: int, most: int, told: str) -> int:
    if not text.isdecimal() or len(text) > len(str(most)) or not least <= int(text) <= most:
        of = "of " * told.startswith("at")
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a whole number {of}{told}")
    return int(text)


def add_options(parser: argparse.ArgumentParser, kind: Callable[..., Any], beside: Collection[str] = ()) -> None:
    """Give a parser an option for each argument of a constructor or function; type, default and help stand there.

    Args:
        parser: The parser.
        kind: The constructor or function.
        beside: Arguments that are no options.
    """
    hints, told = get_type_hints(_signed(kind)), _told(kind)
    for name in _parameters(kind, beside):
        parameter = inspect.signature(kind).parameters[name]
        required, default = parameter.default is parameter.empty, parameter.default
        shown = "" if required or default in (None, (), False) else f" (default: {default})"
        settings: dict[str, Any] = {"help": told.get(name, "") + shown, "dest": name}
        settings |= {"required": True} if required else {"default": default}
        try:
            parser.add_argument(f"--{name}", **settings, **_reader(hints[name]))
        except argparse.ArgumentError:
            raise ConfigError(f"{parser.prog}: the option --{name} is there twice; rename the format's own") from None


def chosen(options: argparse.Namespace, kind: Callable[..., Any], beside: Collection[str] = ()) -> dict[str, Any]:
    """Values of what :func:`add_options` made options for."""
    values = {name: getattr(options, name) for name in _parameters(kind, beside)}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}


def _parameters(kind: Callable[..., Any], beside: Collection[str]) -> list[str]:
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [p.name for p in inspect.signature(kind).parameters.values() if p.kind in named and p.name not in beside]


def _signed(kind: Callable[..., Any]) -> Any:
    """The object that holds the annotations of a constructor's arguments, or of a function's."""
    return kind.__init__ if isinstance(kind, type) and not is_dataclass(kind) else kind  # type: ignore[misc]


def _reader(hint: Any) -> dict[str, Any]:
    """Function by which argparse reads a value of a type."""
    if get_origin(hint) in (Union, UnionType):
        hint = next(part for part in get_args(hint) if part is not type(None))
    if hint is bool:
        return {"action": "store_true"}
    if get_origin(hint) is tuple:
        return {"type": get_args(hint)[0], "nargs": "+", "action": _Gather}
    return {"choices": get_args(hint)} if get_origin(hint) is Literal else {"type": hint}


def _told(kind: Callable[..., Any]) -> dict[str, str]:
    """Descriptions of arguments, out of a docstring."""
    lines = re.split(r"^\s*Args:\s*$", inspect.getdoc(kind) or "", flags=re.MULTILINE)[-1]
    found = re.findall(r"^ {4}(\w+): (.+(?:\n {5,}.+)*)", lines, flags=re.MULTILINE)
    return {name: " ".join(text.split()).replace("%", "%%") for name, text in found}
