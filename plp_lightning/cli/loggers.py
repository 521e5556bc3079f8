"""Loggers beside a run's own, Lightning's or one's own: ``--trainer.logger`` and its settings as a list of classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jsonargparse import ArgumentParser
from lightning.pytorch.loggers import Logger

from datamodules.errors import ConfigError
from datamodules.words import expand_home
from plp_lightning.cli.classes import defaults, find_class
from plp_lightning.cli.layers import check_shape
from plp_lightning.cli.yaml_files import Tree, read_value

FLAG = "--trainer.logger"
FOLDER, TITLE = "{folder}", "{title}"
"""What a logger's ``save_dir`` and name are where nobody says: the phase's folder, and the names of run and phase."""


@dataclass(frozen=True)
class Loggers:
    """Builds loggers of a phase from plain settings, in whose texts ``{folder}`` and ``{title}`` stand for its own."""

    chosen: Sequence[Tree]

    def __call__(self, folder: Path, title: str) -> list[Logger]:
        parser = ArgumentParser(exit_on_error=False)
        parser.add_argument("--logger", type=list[Logger])
        named = [{**item, "init_args": _filled(item.get("init_args") or {}, folder, title)} for item in self.chosen]
        made: list[Logger] = parser.instantiate(parser.parse_object({"logger": named})).logger
        return made


def _filled(settings: Mapping[str, Any], folder: Path, title: str) -> Tree:
    def fill(value: Any) -> Any:
        return value.replace(FOLDER, str(folder)).replace(TITLE, title) if isinstance(value, str) else value

    return {name: fill(value) for name, value in settings.items()}


def listed(tree: Tree) -> Tree:
    """A configuration in which loggers, however they are stated, are a list of classes with settings."""
    trainer = tree.get("trainer")
    if not isinstance(trainer, Mapping):
        return tree
    found = {key: _items(value) for key, value in trainer.items() if key in ("logger", "logger+")}
    return {**tree, "trainer": {**trainer, **found}} if found else tree


def _items(value: Any) -> list[Tree]:
    """One logger is a list of one, a word a class without settings; null and true are no loggers beside a run's."""
    if value is None or value is True:
        return []
    items = [{"class_path": x} if isinstance(x, str) else x for x in (value if isinstance(value, list) else [value])]
    if not all(isinstance(item, Mapping) and isinstance(item.get("class_path"), str) for item in items):
        told = "a logger's class, or a list of them, beside TensorBoard and metrics.csv, which every run has"
        raise ConfigError(
            f"trainer.logger is {value!r}; expected {told}: name one, such as CSVLogger, or leave it away"
        )
    return [dict(item) for item in items]


def with_loggers(tree: Tree, flags: Sequence[str], allowed: Sequence[str]) -> tuple[Tree, list[str]]:
    """Take in the flags of loggers, in their order: a class, one more (``+``), and settings of the last.

    Returns:
        The configuration, in which every logger has a place and a name; and the other flags.
    """
    trainer = dict(tree.get("trainer") or {})
    chosen, rest, words = _items(trainer.get("logger")), list[str](), iter(flags)
    for word in words:
        key, joint, value = word.partition("=")
        if key.rstrip("+") == FLAG or (key.startswith(f"{FLAG}.") and key != f"{FLAG}.help"):
            text = value if joint else next(words, "--")
            chosen = _told(chosen, key.removeprefix(FLAG), text)
        else:
            rest.append(word)
    check_shape(chosen, "trainer.logger")
    return {**tree, "trainer": {**trainer, "logger": [_settled(item, allowed) for item in chosen] or None}}, rest


def _told(chosen: list[Tree], key: str, text: str) -> list[Tree]:
    if text.startswith("--") or (not text and not key.startswith(".")):
        raise ConfigError(f"{FLAG}{key} has no value; give one, such as {FLAG} CSVLogger")
    if not key.startswith("."):
        return [*(chosen if key else []), *_items(read_value(text))]
    if not chosen:
        raise ConfigError(f"{FLAG}{key} is of no logger; expected its class before it: add {FLAG} CSVLogger")
    *before, last = chosen
    if key == ".class_path":
        return [*before, {**last, "class_path": text}]
    name = key.removeprefix(".").removeprefix("init_args.")
    return [*before, {**last, "init_args": {**(last.get("init_args") or {}), name: expand_home(text)}}]


def _settled(item: Tree, allowed: Sequence[str]) -> Tree:
    kind = find_class(str(item["class_path"]), allowed)
    known = defaults(kind) if kind is not None else {}
    unsaid = {"save_dir": FOLDER, "run_name" if "run_name" in known else "name": TITLE}
    own = {name: value for name, value in unsaid.items() if name in known}
    return {**item, "init_args": own | (item.get("init_args") or {})}
