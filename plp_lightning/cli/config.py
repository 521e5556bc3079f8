"""Configuration files and command-line overrides → an experiment. All of jsonargparse lives here."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser, Namespace, set_parsing_settings
from lightning.pytorch import Callback, Trainer

from datamodules.amounts import DataSettings
from datamodules.errors import ConfigError
from datamodules.problem import TransferRoles
from datamodules.settings import PositiveInt, Seed, Threads
from datamodules.transfer import TransferDataModule
from plp_lightning import callbacks, envs, methods  # noqa: F401  (short class names work once these are imported)
from plp_lightning.cli.classes import ALLOWED_IMPORTS
from plp_lightning.cli.explanation import explain
from plp_lightning.cli.layers import Tree, completed, insert, overlay, read_yaml, without_spare_parts
from plp_lightning.cli.renamed import rename, rename_flag
from plp_lightning.envs import experts  # noqa: F401
from plp_lightning.envs.base import Domain
from plp_lightning.evaluation.scores import AlignmentScore, JointScore
from plp_lightning.runs.collection import ExpertCollector
from plp_lightning.runs.experiment import Experiment, Method, PhaseFactory, PolicyFactory, check_names, check_roles
from plp_lightning.runs.plans import CollectionConfig, EvaluationPlan

BASE = Path(__file__).parents[1] / "configs" / "base.yaml"
SPARE_TERMS = ("mmd", "tcc", "adversarial", "reconstruction")
"""Alignment terms that pages may set up for the methods that choose them."""
OURS = {"callbacks", "logger", "max_epochs", "default_root_dir", "plugins"}
OURS |= {"enable_checkpointing", "enable_progress_bar"}
"""Arguments of the Trainer that a run sets itself."""


def parse(arguments: Sequence[str]) -> Experiment:
    """Read configuration files and overrides, ``--config FILE`` (repeatable) and the like, and build the experiment.

    Raises:
        ConfigError: If anything in them is wrong; one line that names it.
    """
    allowed = [*ALLOWED_IMPORTS, *option_values(arguments, "allow_imports")]
    allow_imports(allowed)
    tree, dropped, flags = resolve(arguments, allowed)
    parser = build_parser(tree["phases"])
    try:
        config = parser.parse_args(["--config", yaml.safe_dump(tree, sort_keys=False), *flags])
    except argparse.ArgumentError as error:
        raise ConfigError(explain(str(error), parser)) from None
    files = map(Path, option_values(arguments, "config"))
    named = (file.stem for file in files if file.parent.name != "methods")
    config.experiment = config.experiment or next(named, "unnamed")
    return build(parser, config, dropped)


def resolve(arguments: Sequence[str], allowed: Sequence[str]) -> tuple[Tree, list[str], list[str]]:
    """Lay the files over one another, and choose all classes, those that flags name too.

    Returns:
        The configuration, in which every chosen class is complete; keys of alignment terms that are left away; and the
        flags that are left for the parser.
    """
    contents = _contents(arguments)
    phases = _phase_names(contents.values(), option_values(arguments, "phases"))
    tree: Tree = {}
    for path, content in contents.items():
        renamed, changes = rename(content, phases, tree)
        _tell(f"{path}", changes)
        parts = {name: {"class_path": x} for name, x in renamed.items() if name in phases and isinstance(x, str)}
        tree = overlay(tree, renamed | parts, allowed)
    chosen, flags = _class_flags(_flags(arguments, tree), phases)
    chosen, changes = rename(chosen, phases, tree)
    _tell("flags", changes)
    for value in option_values(arguments, "phases"):
        chosen["phases"] = _read(value)
    tree = overlay(tree, chosen, allowed)
    _check_phases(tree, phases)
    kept, dropped = without_spare_parts(tree, phases, SPARE_TERMS)
    return completed(kept, allowed), dropped, flags


def _contents(arguments: Sequence[str]) -> dict[Path, Tree]:
    return {path: read_yaml(path) for path in [BASE, *map(Path, option_values(arguments, "config"))]}


def _tell(place: str, changes: Sequence[str]) -> None:
    if changes:
        more = f", and {len(changes) - 4} more" if len(changes) > 4 else ""
        print(f"plp: {place}: names have changed: {', '.join(changes[:4])}{more}", file=sys.stderr)


def _flags(arguments: Sequence[str], tree: Tree) -> list[str]:
    """All arguments but ``--config`` and ``--phases``, in today's names."""
    kept, words = [], iter(arguments)
    for word in words:
        if word in ("--config", "--phases"):
            kept += [] if next(words, "") else [word]
        elif not word.startswith(("--config=", "--phases=")):
            key, joint, value = word.partition("=")
            new = f"--{rename_flag(key[2:], tree)}" if key.startswith("--") else key
            _tell("flags", [] if new == key else [f"{key} is {new}"])
            kept.append(new + joint + value)
    return kept


def _class_flags(flags: Sequence[str], phases: Sequence[str]) -> tuple[Tree, list[str]]:
    """Flags that choose a class, or leave a part away, as a configuration; and the others."""
    part = rf"policy|{'|'.join(map(re.escape, phases))}|domains\.\w+\.(?:simulator|expert)"
    place = re.compile(rf"--((?:{part})(?:\.terms(?:\.\w+)?|\.optimizer|\.lr_scheduler?|\.clip)?)(\.class_path)?")
    chosen: Tree = {}
    rest, words = [], iter(flags)
    for word in words:
        key, joint, value = word.partition("=")
        found = place.fullmatch(key)
        if found is None:
            rest.append(word)
            continue
        content = _read(value if joint else next(words, ""))
        if found[2] or (isinstance(content, str) and not found[1].endswith(".lr_schedule")):
            content = {"class_path": content}
        insert(chosen, re.sub(r"^(\w+)\.(?=terms|optimizer|lr_schedule|clip)", r"\1.init_args.", found[1]), content)
    return chosen, rest


def help_parser(arguments: Sequence[str]) -> ArgumentParser:
    """Parser whose help shows all that can follow the given files and flags."""
    return build_parser(_phase_names(_contents(arguments).values(), option_values(arguments, "phases")))


def build_parser(phases: Sequence[str]) -> ArgumentParser:
    """Parser for an experiment whose method has these phases; each phase is a key of its own."""
    parser = ArgumentParser(prog="plp fit", exit_on_error=False)
    parser.add_argument("--config", action="config", help="YAML file; give several, later ones win")
    parser.add_argument("--allow_imports", type=str | None, help="package of yours whose classes configs may name")
    parser.add_argument("--experiment", type=str | None, help="name; the first config's file name if not given")
    parser.add_argument("--method", type=str, help="name of the method, for the run directory")
    parser.add_argument("--seed", type=Seed, default=0, help="seed of weights, batches and evaluation")
    parser.add_argument("--threads", type=Threads, default=1, help="threads of torch; simulators use all cores")
    parser.add_argument("--run_root", type=str, default="runs", help="where run directories go")
    parser.add_argument("--domains", type=dict[str, Domain], help="simulator and expert of each domain")
    parser.add_class_arguments(DataSettings, "data")
    parser.add_class_arguments(CollectionConfig, "collection")
    parser.add_argument("--policy", type=PolicyFactory, help="the policy's class and sizes")
    parser.add_argument("--phases", type=list[str], help="phases of the method, in order; each is a key of its own")
    for name in phases:
        told = f"phase {name}: class, losses, epochs, optimizer"
        parser.add_argument(f"--{name}", type=PhaseFactory, help=told)
    parser.add_class_arguments(EvaluationPlan, "evaluation")
    parser.add_argument("--score", type=list[AlignmentScore] | None, default=[], help="alignment scores; += appends")
    parser.add_argument("--callbacks", type=list[Callback], default=[], help="further callbacks; += appends")
    parser.add_argument("--trainer.max_epochs", type=PositiveInt | None, help="epochs of every phase, not its own")
    parser.add_class_arguments(Trainer, "trainer", skip=OURS, instantiate=False)
    return parser


def allow_imports(packages: Sequence[str]) -> None:
    """Let configurations name classes below ``packages`` and nothing else, nor files behind a URL."""
    set_parsing_settings(
        import_path_denylist=["*"], import_path_allowlist=list(packages), config_read_mode_fsspec_enabled=False
    )


def _phase_names(contents: Iterable[Tree], flags: Sequence[str] = ()) -> list[str]:
    """Phases that files and flags name; a method that leaves one out still reads pages that set it up."""
    lists = [content["phases"] for content in contents if "phases" in content] + [_read(value) for value in flags]
    for names in lists:
        if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"phases is {names!r}; expected a list of names, such as [alignment, adaptation]")
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigError(f"phases names {twice[0]!r} twice; expected each phase once")
    return list(dict.fromkeys(name for names in lists for name in names))


def option_values(arguments: Sequence[str], name: str) -> list[str]:
    """Values of ``--name VALUE`` and ``--name=VALUE``, in order."""
    joined = [a if a != f"--{name}" else f"{a}={b}" for a, b in zip(arguments, [*arguments, ""][1:], strict=True)]
    return [value for a in joined if a.startswith(f"--{name}=") and (value := a.split("=", 1)[1])]


def build(parser: ArgumentParser, config: Namespace, dropped: Sequence[str] = ()) -> Experiment:
    """Objects from a parsed configuration; nothing is read from disk and nothing simulated yet.

    ``dropped`` are keys of alignment terms that are left away: they are null in the configuration that is kept.
    """
    config.score = config.score or []
    kept = yaml.safe_load(parser.dump(config.clone(), skip_unset=False))
    for key in dropped:
        insert(kept, key, None)
    made = parser.instantiate(config)
    for key in ("domains", "method"):
        if not made[key]:
            raise ConfigError(f"{key} is not set; give an experiment, such as --config configs/r2r.yaml")
    check_names({"experiment": made.experiment, "method": made.method})
    return Experiment(
        name=made.experiment,
        method=Method(made.method, made.policy, {name: made[name] for name in made.phases}),
        seed=made.seed,
        threads=made.threads,
        run_root=Path(made.run_root),
        domains=made.domains,
        data=_data(made, made.data),
        evaluation=made.evaluation,
        score=JointScore(made.score) if made.score else None,
        callbacks=made.callbacks,
        trainer=dict(vars(made.trainer)),
        config=yaml.safe_dump(kept, sort_keys=False),
    )


def _data(made: Namespace, data: DataSettings) -> TransferDataModule:
    check_roles(made.domains, data.source_domain, data.target_domain)
    tasks = made.domains[data.source_domain].simulator.tasks
    folder = Path(data.root or os.environ.get("PLP_DATA", "data"))
    roles = TransferRoles(
        domains=tuple(made.domains),
        source_domain=data.source_domain,
        target_domain=data.target_domain,
        tasks=tasks.names,
        proxy_tasks=tasks.proxies(data.target_task, data.proxy_goals),
        target_task=data.target_task,
        target_tasks=tasks.of(data.target_task),
    )
    path = Path(data.file) if data.file else folder / f"{made.experiment}.hdf5"
    collector = ExpertCollector(made.domains, made.collection)
    return TransferDataModule(path, roles, data, data, made.seed, data.image_memory, collector)


def _check_phases(tree: Tree, phases: Sequence[str]) -> None:
    known = [name for name in phases if (tree.get(name) or {}).get("class_path")]
    for name in tree["phases"]:
        if name not in known:
            choice = ", ".join(known)
            raise ConfigError(f"phases names {name!r}, which nothing sets up; set {name}.class_path, or name: {choice}")


def _read(text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text
