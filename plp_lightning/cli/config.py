"""Configuration files and command-line overrides → an experiment. All of jsonargparse lives here."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import yaml
from jsonargparse import ArgumentParser, Namespace, set_loader, set_parsing_settings
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.loggers import Logger

from datamodules.amounts import DataSettings
from datamodules.errors import ConfigError
from datamodules.plain_yaml import dump_yaml
from datamodules.settings import PositiveInt, Seed, Threads
from plp_lightning import callbacks, envs, methods  # noqa: F401  (short class names work once these are imported)
from plp_lightning.cli.building import build
from plp_lightning.cli.classes import ALLOWED_IMPORTS, check_imports
from plp_lightning.cli.explanation import OURS, explain
from plp_lightning.cli.layers import check_shape, completed, insert, overlay, with_encoder_class, without_spare_parts
from plp_lightning.cli.loggers import listed, with_loggers
from plp_lightning.cli.renamed import rename, rename_flag
from plp_lightning.cli.yaml_files import Tree, read_page_or_word, read_value, read_yaml
from plp_lightning.envs import experts  # noqa: F401
from plp_lightning.envs.base import Domain
from plp_lightning.evaluation import mixing  # noqa: F401
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.networks import ImageEncoderFactory
from plp_lightning.plugins import find_in_working_folder, plugins
from plp_lightning.runs.experiment import Experiment, PhaseFactory, PolicyFactory
from plp_lightning.runs.plans import CollectionConfig, EvaluationPlan, HandoverPlan

PAGES = Path(__file__).parents[1] / "configs"
BASE = PAGES / "base.yaml"
LISTS = ("--score", "--callbacks")  # Flags that hold lists of classes
SPARE_TERMS = ("mmd", "tcc", "adversarial", "reconstruction")
"""Alignment terms that pages may set up for the methods that choose them."""


def parse(arguments: Sequence[str]) -> Experiment:
    """Read configuration files and overrides as :func:`read` does, and tell which names in them have changed."""
    experiment, changes = read(arguments)
    tell(changes)
    return experiment


def read(arguments: Sequence[str]) -> tuple[Experiment, list[str]]:
    """Read configuration files and overrides, ``--config FILE`` (repeatable) and the like, and build the experiment.

    Returns:
        The experiment, and a line for each file in which names have changed.

    Raises:
        ConfigError: If anything in them is wrong; one line that names it.
    """
    own = option_values(arguments, "allow_imports")
    find_in_working_folder(own)
    allowed = [*ALLOWED_IMPORTS, *plugins(), *own]
    allow_imports(allowed)
    found = resolve(arguments, allowed)
    parser = _parser_of(*found.tree["phases"])
    config = parsed(parser, ["--config", dump_yaml(found.tree), *found.flags])
    files = map(find_page, option_values(arguments, "config"))
    named = (file.stem for file in files if file.parent.name != "methods")
    if config.experiment is None:
        config.experiment = next(named, "unnamed")
    experiment = build(parser, config, found.dropped)
    check_imports(experiment.simulators, allowed)
    return experiment, found.changes


def find_page(name: str) -> Path:
    """The file of that name; or, if there is none, the page that this package brings: ``r2r``, ``methods/plp_t``."""
    ours = PAGES / f"{name}.yaml"
    return ours if not Path(name).exists() and ours.is_relative_to(PAGES) and ours.is_file() else Path(name)


def parsed(parser: ArgumentParser, words: list[str]) -> Namespace:
    """Words as a parser reads them; a :class:`ConfigError` tells its complaint in one line."""
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told):
            config = parser.parse_args(words)
    except argparse.ArgumentError as error:
        raise ConfigError(explain(str(error), parser)) from None
    except SystemExit as leaving:  # help of a class is a parser of its own, which tells mistakes in its own way
        if leaving.code:
            raise ConfigError(explain(told.getvalue().splitlines()[-1], parser)) from None
        raise
    print(told.getvalue(), end="", file=sys.stderr)
    return config


def tell(changes: Sequence[str]) -> None:
    """Print what has changed, one line each."""
    for line in changes:
        print(f"plp: {line}", file=sys.stderr)


def trusted(packages: Sequence[str]) -> list[str]:
    """Words that trust packages of the user's: a run's own configuration cannot vouch for them."""
    return [f"--allow_imports={name}" for name in packages]


class Resolved(NamedTuple):
    """Files and flags that choose classes, laid over one another."""

    tree: Tree  # The configuration, in which every chosen class is complete
    dropped: list[str]  # Keys of alignment terms that are left away
    flags: list[str]  # Those that are left for the parser
    changes: list[str]  # Lines about names that have changed


def resolve(arguments: Sequence[str], allowed: Sequence[str]) -> Resolved:
    """Lay the files over one another, and choose all classes, those that flags name too."""
    contents = _contents(arguments)
    phases = _phase_names(contents.values(), option_values(arguments, "phases"))
    tree, told = Tree(), list[str]()
    for path, content in contents.items():
        check_shape(content)
        renamed, changes = rename(content, phases, tree)
        told += _notice(f"{path}", changes)
        parts = {name: {"class_path": x} for name, x in renamed.items() if name in phases and isinstance(x, str)}
        tree = overlay(tree, with_encoder_class(listed(renamed | parts), tree), allowed)
    words, changes = _flags(arguments, tree)
    tree, words = with_loggers(tree, words, allowed)
    chosen, flags = _class_flags(words, phases)
    check_shape(chosen)
    chosen, more = rename(chosen, phases, tree)
    for value in option_values(arguments, "phases"):
        chosen["phases"] = read_value(value)
    tree = overlay(tree, with_encoder_class(chosen, tree), allowed)
    _check_phases(tree, phases)
    kept, dropped = without_spare_parts(tree, phases, SPARE_TERMS)
    return Resolved(completed(kept, allowed), dropped, flags, [*told, *_notice("flags", [*changes, *more])])


def _contents(arguments: Sequence[str]) -> dict[Path, Tree]:
    return {path: read_yaml(path) for path in [BASE, *map(find_page, option_values(arguments, "config"))]}


def _notice(place: str, changes: Sequence[str]) -> list[str]:
    more = f", and {len(changes) - 4} more" if len(changes) > 4 else ""
    return [f"{place}: names have changed: {', '.join(changes[:4])}{more}"] if changes else []


def _flags(arguments: Sequence[str], tree: Tree) -> tuple[list[str], list[str]]:
    """All arguments but ``--config`` and ``--phases``, in today's names, and those that have changed."""
    kept, changes, words = list[str](), list[str](), iter(arguments)
    for word in words:
        if word in ("--config", "--phases"):
            kept += [] if next(words, None) is not None else [word]
        elif not word.startswith(("--config=", "--phases=")):
            key, joint, value = word.partition("=")
            new = f"--{rename_flag(key[2:], tree)}" if key.startswith("--") else key
            changes += [] if new == key else [f"{key} is {new}"]
            kept += [new, _listed(value if joint else next(words, ""))] if key in LISTS else [new + joint + value]
    return kept, changes


def _listed(value: str) -> str:
    """One class is a list of one."""
    return f"[{value}]" if re.fullmatch(r"(?!null$)[^\W\d][\w.]*", value) else value


def _class_flags(flags: Sequence[str], phases: Sequence[str]) -> tuple[Tree, list[str]]:
    """Flags that choose a class, or leave a part away, as a configuration; and the others."""
    part = rf"policy|{'|'.join(map(re.escape, phases))}|domains\.\w+\.(?:simulator|expert)"
    inner = r"terms(?:\.\w+)?|optimizer|lr_scheduler?|clip|image_encoder"
    place = re.compile(rf"--((?:{part})(?:\.(?:{inner}))?)(\.class_path)?")
    chosen: Tree = {}
    rest, words = [], iter(flags)
    for word in words:
        key, joint, value = word.partition("=")
        found = place.fullmatch(key)
        if found is None:
            rest.append(word)
            continue
        content = read_value(value if joint else next(words, ""))
        if found[2] or (isinstance(content, str) and not found[1].endswith(".lr_schedule")):
            content = {"class_path": content}
        insert(chosen, re.sub(rf"^(\w+)\.(?={inner})", r"\1.init_args.", found[1]), content)
    return chosen, rest


def help_parser(arguments: Sequence[str]) -> ArgumentParser:
    """Parser whose help shows all that can follow the given files and flags."""
    return build_parser(_phase_names(_contents(arguments).values(), option_values(arguments, "phases")))


@lru_cache(maxsize=8)
def _parser_of(*phases: str) -> ArgumentParser:
    """The same parser for each run of these phases: a sweep reads many."""
    return build_parser(phases)


def build_parser(phases: Sequence[str]) -> ArgumentParser:
    """Parser for an experiment whose method has these phases; each phase is a key of its own."""
    parser = ArgumentParser(prog="plp fit", exit_on_error=False)
    parser.add_argument("--config", action="config", metavar="PAGE", help="YAML file; give several, later ones win")
    parser.add_argument("--allow_imports", type=str | None, help="package of yours whose classes configs may name")
    parser.add_argument("--experiment", type=str | None, help="name; the first config's file name if not given")
    parser.add_argument("--method", type=str, help="name of the method, for the run directory")
    told = "name of the settings that are laid over page and method; it follows the method's in the run directory"
    parser.add_argument("--recipe", type=str | None, help=told)
    parser.add_argument("--sweep", type=str | None, help="page of the sweep that the run is part of; for results.json")
    parser.add_argument("--seed", type=Seed, default=0, help="seed of weights, batches and evaluation")
    parser.add_argument("--threads", type=Threads, default=1, help="threads of torch; simulators use all cores")
    parser.add_argument(
        "--cuda_graphs", type=bool, default=False, help="launch a GPU's training steps as one graph each"
    )
    parser.add_argument("--run_root", type=str, default="runs", help="where run directories go")
    parser.add_argument("--domains", type=dict[str, Domain], help="simulator and expert of each domain")
    parser.add_class_arguments(DataSettings, "data")
    parser.add_class_arguments(CollectionConfig, "collection")
    parser.add_argument("--policy", type=PolicyFactory, help="the policy's class and sizes")
    parser.add_argument("--phases", type=list[str], help="phases of the method, in order; each is a key of its own")
    for name in phases:
        told = f"phase {name}: class, losses, epochs, optimizer"
        parser.add_argument(f"--{name}", type=PhaseFactory, help=told)
    parser.add_class_arguments(HandoverPlan, "handover")
    parser.add_class_arguments(EvaluationPlan, "evaluation")
    parser.add_argument("--score", type=list[AlignmentScore] | None, default=[], help="alignment scores; += appends")
    parser.add_argument("--callbacks", type=list[Callback], default=[], help="further callbacks; += appends")
    parser.add_argument("--trainer.max_epochs", type=PositiveInt | None, help="epochs of every phase, not its own")
    parser.add_argument("--trainer.logger", type=list[Logger] | None, help="loggers beside a run's own; += appends")
    own = {"max_epochs", "logger", *(key.removeprefix("trainer.") for key in OURS)}
    parser.add_class_arguments(Trainer, "trainer", skip=own, instantiate=False)
    return parser


def allow_imports(packages: Sequence[str]) -> None:
    """Let configurations name classes below ``packages`` and nothing else, nor files behind a URL; one reader for all.

    Raises:
        ConfigError: If one is no package that can be imported.
    """
    for name in packages:
        _check_package(name)
    set_parsing_settings(
        import_path_denylist=["*"],
        import_path_allowlist=list(packages),
        config_read_mode_fsspec_enabled=False,
        subclasses_enabled=[ImageEncoderFactory],
    )
    set_loader("yaml", read_page_or_word, (yaml.YAMLError,))


def _check_package(name: str) -> None:
    told = f"--allow_imports is {name!r}; expected the name of a package on Python's path, such as mine or mine.losses"
    if not all(part.isidentifier() for part in name.split(".")):
        raise ConfigError(told)
    try:
        found = find_spec(name)
    except Exception as error:  # what a package above it does when it is imported is not ours
        raise ConfigError(f"{told} ({type(error).__name__}: {error})") from None
    if found is None:
        raise ConfigError(told)


def _phase_names(contents: Iterable[Tree], flags: Sequence[str] = ()) -> list[str]:
    """Phases that files and flags name; a method that leaves one out still reads pages that set it up."""
    lists = [content["phases"] for content in contents if "phases" in content] + [read_value(value) for value in flags]
    for names in lists:
        if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"phases is {names!r}; expected a list of names, such as [alignment, adaptation]")
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigError(f"phases names {twice[0]!r} twice; expected each phase once")
    return list(dict.fromkeys(name for names in lists for name in names))


def option_values(arguments: Sequence[str], name: str) -> list[str]:
    """Values of ``--name VALUE`` and ``--name=VALUE``, in order."""
    option, after = f"--{name}", [*arguments[1:], None]
    pairs = [pair for pair in zip(arguments, after, strict=False) if pair[0].partition("=")[0] == option]
    values = [word.partition("=")[2] if "=" in word else following for word, following in pairs]
    return [value for value in values if value is not None]


def _check_phases(tree: Tree, phases: Sequence[str]) -> None:
    for name in phases:
        if not isinstance(tree.get(name), Mapping | None):
            raise ConfigError(f"{name} is {tree[name]!r}; expected a class, as configs/methods have it: mend it")
    known = [name for name in phases if (tree.get(name) or {}).get("class_path")]
    for name in tree["phases"]:
        if name not in known:
            choice = ", ".join(known)
            raise ConfigError(f"phases names {name!r}, which nothing sets up; set {name}.class_path, or name: {choice}")
