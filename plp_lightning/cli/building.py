"""A parsed configuration → an experiment."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from jsonargparse import ArgumentParser, Namespace

from datamodules.amounts import DataSettings
from datamodules.errors import ConfigError, UserError
from datamodules.plain_yaml import dump_yaml
from datamodules.transfer import TransferDataModule
from datamodules.words import expand_home
from plp_lightning.cli.keeping import keep
from plp_lightning.cli.loggers import Loggers
from plp_lightning.evaluation.scores import JointScore
from plp_lightning.runs.collection import ExpertCollector
from plp_lightning.runs.experiment import Experiment, Method, check_names
from plp_lightning.runs.roles import find_roles

NEEDED = ("domains", "method", "policy", "phases")


def build(parser: ArgumentParser, config: Namespace, dropped: Sequence[str] = ()) -> Experiment:
    """Objects from a parsed configuration; nothing is read from disk and nothing simulated yet.

    ``dropped`` are keys of alignment terms that are left away: they are null in the configuration that is kept.

    Raises:
        ConfigError: If an object can't be built, or the configuration not be kept.
    """
    _check_needed(config)
    config.score = config.score or []
    _settle_places(config)
    kept = keep(parser, config, dropped)
    config.trainer.logger = None  # a phase builds its own
    made = _made(parser, config)
    method = _method_name(made.method, made.recipe)
    check_names({"experiment": made.experiment, "method": method})
    made.handover.check(made.phases, made.data.val_fraction)
    return Experiment(
        name=made.experiment,
        method=Method(method, made.policy, {name: made[name] for name in made.phases}),
        seed=made.seed,
        threads=made.threads,
        cuda_graphs=made.cuda_graphs,
        run_root=Path(made.run_root),
        domains=made.domains,
        data=_data(made, made.data),
        handover=made.handover,
        evaluation=made.evaluation,
        score=JointScore(made.score) if made.score else None,
        callbacks=made.callbacks,
        trainer={key: value for key, value in vars(made.trainer).items() if key != "logger"},
        loggers=Loggers(kept["trainer"]["logger"] or []),
        config=dump_yaml(kept),
    )


def _method_name(method: str, recipe: str | None) -> str:
    """A method's name with that of the recipe behind it, if there is one; an override of a sweep may say it already."""
    return method if not recipe or method.endswith(f"_{recipe}") else f"{method}_{recipe}"


def _made(parser: ArgumentParser, config: Namespace) -> Namespace:
    try:
        made: Namespace = parser.instantiate(config)
    except UserError:
        raise
    except Exception as error:  # classes of others have errors of their own for settings that cannot be
        raise ConfigError(f"a setting is impossible: {type(error).__name__}: {error}; change it") from None
    return made


def _check_needed(config: Namespace) -> None:
    for key in NEEDED:
        if not config[key]:
            raise ConfigError(f"{key} is not set; give an experiment, such as --config configs/r2r.yaml")


def _settle_places(config: Namespace) -> None:
    """Say where things lie for good: a run finds its demonstrations from any folder."""
    for key in ("run_root", "data.root", "data.file"):
        if config[key] == "" or (key == "run_root" and config[key] is None):
            raise ConfigError(f"{key} is empty; expected a path: name one or leave it away")
    config["data.root"] = str(Path(config["data.root"] or expand_home(os.environ.get("PLP_DATA") or "data")).absolute())
    if config["data.file"] is not None:
        config["data.file"] = str(Path(config["data.file"]).absolute())


def _data(made: Namespace, data: DataSettings) -> TransferDataModule:
    path = Path(data.file) if data.file else Path(str(data.root)) / f"{made.experiment}.hdf5"
    roles = find_roles(made.domains, data, path)
    simulated = all(domain.simulator is not None for domain in made.domains.values())
    collector = ExpertCollector(made.domains, made.collection) if simulated else None
    memory, fixed_shapes = data.image_memory, made.cuda_graphs
    return TransferDataModule(path, roles, data, data, made.seed, memory, collector, fixed_shapes)
