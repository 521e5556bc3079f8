"""``plp collect --train_expert``: a gait for one of an experiment's walkers."""

from __future__ import annotations

import shlex
import sys
from importlib.util import find_spec
from pathlib import Path

from datamodules.errors import ConfigError
from plp_lightning.envs.maze.simulator import WalkerMaze
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.progress import JobProgress


def train_expert(experiment: Experiment, domain: str, weights: Path, steps: int) -> None:
    """Train the expert of a domain, a :class:`WalkerMaze`, with PPO for so many control steps, from the run's seed.

    The gait goes into ``weights`` as safetensors, its provenance beside it as JSON.

    Raises:
        ConfigError: If the domain's expert cannot be trained, a file is in the way, or stable-baselines3 is missing.
    """
    legs = _walker(experiment, domain).legs
    _check_place(weights)
    if find_spec("stable_baselines3") is None:
        remedy = "install the extra 'experts' with: pip install -e '.[experts]'"
        raise ConfigError(f"training an expert needs stable-baselines3, which is not installed; {remedy}")
    from plp_lightning.envs.experts.train_walker import train_walker

    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    with JobProgress(f"training {domain}", steps, "steps") as progress:
        train_walker(legs, weights, command, progress.advance, steps, experiment.seed)
    print(f"{weights}: written; demonstrate with it by --domains.{domain}.expert.weights {weights}")


def _walker(experiment: Experiment, domain: str) -> WalkerMaze:
    if domain not in experiment.domains:
        raise ConfigError(f"--train_expert is {domain!r}; the experiment's domains are {', '.join(experiment.domains)}")
    simulator = experiment.domains[domain].simulator
    if not isinstance(simulator, WalkerMaze):
        found = type(simulator).__name__
        raise ConfigError(f"--train_expert {domain}: only experts of WalkerMaze are trained, not those of {found}")
    return simulator


def _check_place(weights: Path) -> None:
    if weights.suffix != ".safetensors":
        raise ConfigError(f"--weights is {str(weights)!r}; expected a name that ends in .safetensors")
    taken = next((path for path in (weights, weights.with_suffix(".json")) if path.exists()), None)
    if taken is not None:
        raise ConfigError(f"{taken}: the file exists; expected a new one: name another with --weights or remove it")
