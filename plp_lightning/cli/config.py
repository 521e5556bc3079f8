"""Configuration files and command-line overrides → an experiment. All of jsonargparse lives here."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jsonargparse import ArgumentParser, Namespace, set_parsing_settings
from lightning.pytorch import Callback, Trainer

from datamodules.errors import ConfigError
from datamodules.transfer import TransferDataModule
from plp_lightning import callbacks, envs, methods  # noqa: F401  (short class names work once these are imported)
from plp_lightning.cli.allowlist import ALLOWED_IMPORTS
from plp_lightning.cli.explanation import explain
from plp_lightning.envs import experts  # noqa: F401
from plp_lightning.envs.base import Domain
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.runs.collection import CollectionConfig, ExpertCollector
from plp_lightning.runs.experiment import (
    EvaluationPlan,
    Experiment,
    PhaseFactory,
    PolicyFactory,
    check_names,
    check_numbers,
    check_roles,
)

BASE = Path(__file__).parents[1] / "configs" / "base.yaml"
LINKED = {"path", "tasks", "proxy_tasks", "target_tasks", "domains", "seed", "collector"}
"""Arguments of the DataModule that follow from others."""
OURS = {
    "callbacks",
    "logger",
    "max_epochs",
    "default_root_dir",
    "enable_checkpointing",
    "enable_progress_bar",
    "plugins",
}
"""Arguments of the Trainer that a run sets itself."""


def parse(arguments: Sequence[str]) -> Experiment:
    """Read configuration files and overrides, and build the experiment.

    Args:
        arguments: As on the command line: ``--config FILE`` (repeatable), ``--data.target_task NAME``, …

    Raises:
        ConfigError: If anything in them is wrong; one line that names it.
    """
    allow_imports([*ALLOWED_IMPORTS, *option_values(arguments, "allow_imports")])
    phases = phase_names(arguments)
    parser = build_parser(phases)
    try:
        config = parser.parse_args(list(arguments), defaults=True)
    except argparse.ArgumentError as error:
        raise ConfigError(explain(str(error), parser)) from None
    return build(parser, config, phases)


def build_parser(phases: Sequence[str]) -> ArgumentParser:
    """Parser for an experiment whose method has these phases; each phase is a key of its own."""
    parser = ArgumentParser(prog="plp fit", exit_on_error=False, default_config_files=[str(BASE)])
    parser.add_argument("--config", action="config", help="YAML file; give several, later ones win")
    parser.add_argument("--allow_imports", type=str | None, help="package of yours whose classes configs may name")
    parser.add_argument("--experiment", type=str | None, help="name; the first config's file name if not given")
    parser.add_argument("--method", type=str, help="name of the method, for the run directory")
    parser.add_argument("--seed", type=int, default=0, help="seed of initial weights, batches and evaluation")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch; simulators use all cores anyway")
    parser.add_argument("--run_root", type=str, default="runs", help="where run directories go")
    parser.add_argument("--domains", type=dict[str, Domain], help="simulator and expert of each domain")
    parser.add_class_arguments(TransferDataModule, "data", skip=LINKED, instantiate=False)
    parser.add_argument(
        "--data.root", type=str | None, help="folder of trajectory files; PLP_DATA or data if not given"
    )
    parser.add_argument("--data.file", type=str | None, help="trajectory file; <root>/<experiment>.hdf5 if not given")
    parser.add_argument("--data.proxy_goals", type=int | None, help="goals that proxy tasks end at; all if not given")
    parser.add_class_arguments(CollectionConfig, "collection")
    parser.add_argument("--policy", type=PolicyFactory, help="the policy's class and sizes")
    parser.add_argument("--phases", type=list[str], help="phases of the method, in order; each is a key of its own")
    for name in phases:
        parser.add_argument(f"--{name}", type=PhaseFactory, help=f"phase {name}: class, losses, epochs, optimiser")
    parser.add_class_arguments(EvaluationPlan, "evaluation")
    parser.add_argument("--score", type=AlignmentScore | None, help="alignment score")
    parser.add_argument("--callbacks", type=list[Callback], default=[], help="further callbacks; += appends")
    parser.add_argument("--trainer.max_epochs", type=int | None, help="epochs of every phase, instead of its own")
    parser.add_class_arguments(Trainer, "trainer", skip=OURS, instantiate=False)
    return parser


def allow_imports(packages: Sequence[str]) -> None:
    """Let configurations name classes below ``packages`` and nothing else, nor files behind a URL."""
    set_parsing_settings(
        import_path_denylist=["*"], import_path_allowlist=list(packages), config_read_mode_fsspec_enabled=False
    )


def phase_names(arguments: Sequence[str]) -> list[str]:
    """Phases that the given files and flags name; a method that leaves one out still reads pages that set it up."""
    files = [_read_yaml(Path(path)) for path in [str(BASE), *option_values(arguments, "config")]]
    lists = [content["phases"] for content in files if "phases" in content]
    lists += [_read_list(value) for value in option_values(arguments, "phases")]
    for names in lists:
        if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"phases is {names!r}; expected a list of names, such as [alignment, adaptation]")
    return list(dict.fromkeys(name for names in lists for name in names))


def option_values(arguments: Sequence[str], name: str) -> list[str]:
    """Values of ``--name VALUE`` and ``--name=VALUE``, in order."""
    joined = [a if a != f"--{name}" else f"{a}={b}" for a, b in zip(arguments, [*arguments, ""][1:], strict=True)]
    return [value for a in joined if a.startswith(f"--{name}=") and (value := a.split("=", 1)[1])]


def build(parser: ArgumentParser, config: Namespace, phases: Sequence[str]) -> Experiment:
    """Objects from a parsed configuration; nothing is read from disk and nothing simulated yet.

    Args:
        parser: Who parsed it.
        config: The configuration.
        phases: Phases that are keys of it; those that the method leaves out are dropped.
    """
    config.experiment = config.experiment or _experiment_name(config)
    _check_phases(config, phases)
    for name in {*phases} - {*config.phases}:
        del config[name]
    check_numbers(dict(config.items()), config.phases)
    text = parser.dump(config.clone(), skip_unset=False)
    made = parser.instantiate(config)
    for key in ("domains", "method"):
        if not made[key]:
            raise ConfigError(f"{key} is not set; give an experiment, such as --config configs/r2r.yaml")
    check_names({"experiment": made.experiment, "method": made.method, "data.target_task": made.data.target_task})
    return Experiment(
        name=made.experiment,
        method=made.method,
        seed=made.seed,
        threads=made.threads,
        run_root=Path(made.run_root),
        domains=made.domains,
        data=_data(made),
        policy=made.policy,
        phases={name: made[name] for name in made.phases},
        evaluation=made.evaluation,
        score=made.score,
        callbacks=made.callbacks,
        trainer=dict(vars(made.trainer)),
        config=text,
    )


def _data(made: Namespace) -> TransferDataModule:
    settings: dict[str, Any] = dict(vars(made.data))
    root, file = settings.pop("root"), settings.pop("file")
    check_roles(made.domains, settings["source_domain"], settings["target_domain"])
    tasks = made.domains[settings["source_domain"]].simulator.tasks
    folder = Path(root or os.environ.get("PLP_DATA", "data"))
    return TransferDataModule(
        path=Path(file) if file else folder / f"{made.experiment}.hdf5",
        tasks=tasks.names,
        proxy_tasks=tasks.proxies(settings["target_task"], settings.pop("proxy_goals")),
        target_tasks=tasks.of(settings["target_task"]),
        domains=list(made.domains),
        seed=made.seed,
        collector=ExpertCollector(made.domains, made.collection),
        **settings,
    )


def _check_phases(config: Namespace, phases: Sequence[str]) -> None:
    known = [name for name in phases if config[name] is not None]
    unknown = [name for name in config.phases if name not in known]
    if unknown:
        name, choice = unknown[0], ", ".join(known)
        raise ConfigError(f"phases names {name!r}, which nothing sets up; set {name}.class_path, or name: {choice}")


def _experiment_name(config: Namespace) -> str:
    files = [Path(str(path)) for path in config.config or []]
    named = [file.stem for file in files if file.parent.name != "methods"]
    return named[0] if named else "unnamed"


def _read_yaml(path: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror}); name an existing YAML file") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: is no YAML ({' '.join(str(error).split())}); mend the file") from None
    if content is not None and not isinstance(content, dict):
        raise ConfigError(f"{path}: holds a {type(content).__name__}; expected keys and values, as in configs/r2r.yaml")
    return content or {}


def _read_list(text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        return text
