"""All that a run is going to build, built once before it begins: wrong settings show while nothing is written."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from importlib.util import find_spec

from datamodules.errors import ConfigError, UserError
from plp_lightning.envs.base import Simulator
from plp_lightning.runs.collection import ExpertCollector
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.specs import check_file


def check_method(experiment: Experiment) -> None:
    """Build the policy, all phases, and their optimizers and schedules.

    Raises:
        ConfigError: If one can't be built, or a score asks simulators that are not there.
    """
    check_packages(experiment.simulators)
    _check_scores(experiment)
    try:
        _build_all(experiment)
    except UserError:
        raise
    except Exception as error:  # each class has errors of its own for settings that cannot be
        raise ConfigError(f"a setting is impossible: {type(error).__name__}: {error}; change it") from None


def check_packages(simulators: Mapping[str, Simulator]) -> None:
    """Refuse, by a :class:`ConfigError`, simulators, by domain, of which a package is not installed."""
    for name, simulator in simulators.items():
        if lacking := [module for module in simulator.needs if find_spec(module) is None]:
            told = f"domain {name!r}: {type(simulator).__name__} needs {lacking[0]}, which is not installed"
            raise ConfigError(f"{told}; install the simulators with: pip install 'plp-lightning[sim]'")


def _check_scores(experiment: Experiment) -> None:
    lacking = [name for name in experiment.domains if name not in experiment.simulators]
    scores = experiment.score.scores if experiment.score is not None else ()
    for score in scores:
        if score.needs_simulators and lacking:
            told = f"score {type(score).__name__} asks simulators, and domain {lacking[0]!r} has none"
            raise ConfigError(f"{told}; expected NeighbourhoodScore or the like: choose another --score")


def _build_all(experiment: Experiment) -> None:
    check_file(experiment.data.path, experiment.specs)
    policy = experiment.method.policy(experiment.unscaled_problem)
    for build in experiment.method.phases.values():
        phase = build(policy)
        optimizer = phase.optimizer(phase.parameter_groups())
        if phase.lr_scheduler is not None:
            phase.lr_scheduler(optimizer)


def check_demonstrations(experiment: Experiment) -> None:
    """Look at the trajectory file, if there is one.

    Raises:
        OSError: If there can be no file of that name.
        UserError: If it is no trajectory file, its demonstrations were collected otherwise, or some are missing that
            nobody can make.
    """
    data = experiment.data
    with contextlib.suppress(FileNotFoundError):
        data.path.stat()
        if data.collector is not None:
            data.collector.check(data.path)
    if data.collector is None:
        data.prepare_data()
    elif isinstance(data.collector, ExpertCollector):
        data.collector.check_experts(data.path, data.missing())
