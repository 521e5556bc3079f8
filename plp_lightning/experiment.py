"""What a configuration describes: an experiment, a method, and how to run them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightning.pytorch import Callback

from datamodules.errors import ConfigError
from datamodules.normalization import Statistics
from datamodules.transfer import TransferDataModule
from datamodules.types import DomainSpec
from plp_lightning.envs.base import Domain, Simulator
from plp_lightning.evaluation.scores import AlignmentScore
from plp_lightning.evaluation.simulation import Trial
from plp_lightning.phases import Phase
from plp_lightning.policy import PortablePolicy

PolicyFactory = Callable[[Sequence[DomainSpec], Sequence[str], Mapping[str, Statistics]], PortablePolicy]
PhaseFactory = Callable[[PortablePolicy], Phase]


@dataclass(frozen=True)
class EvaluationPlan:
    """When and how much to evaluate in the simulators.

    Args:
        every_n_epochs: Epochs between two evaluations, by phase; phases that are not named wait for their end.
        episodes: Episodes of each trial in these.
        final_episodes: Episodes of each trial at the end of a phase.
        score_every_n_epochs: Epochs between two alignment scores.
    """

    every_n_epochs: dict[str, int] = field(default_factory=dict)
    episodes: int = 20
    final_episodes: int = 100
    score_every_n_epochs: int = 5


@dataclass(frozen=True)
class Experiment:
    """Everything that a run needs, built from its configuration."""

    name: str
    method: str
    seed: int
    threads: int
    run_root: Path
    domains: Mapping[str, Domain]
    data: TransferDataModule
    policy: PolicyFactory
    phases: Mapping[str, PhaseFactory]
    """By name, in the order in which they are run."""
    evaluation: EvaluationPlan
    score: AlignmentScore | None
    callbacks: Sequence[Callback]
    trainer: Mapping[str, Any]
    """Arguments of Lightning's Trainer."""
    config: str
    """The resolved configuration as YAML."""

    @property
    def run_path(self) -> Path:
        """``<run_root>/<experiment>/<method>/<target task>/seed_<n>``."""
        return self.run_root / self.name / self.method / self.data.target / f"seed_{self.seed}"

    @property
    def simulators(self) -> dict[str, Simulator]:
        """By domain."""
        return {name: domain.simulator for name, domain in self.domains.items()}

    @property
    def trials(self) -> dict[str, Trial]:
        """Episodes that are run: the target task and the proxy tasks, in target and source domain."""
        data = self.data
        return {
            "target": Trial(data.target_domain, data.target_tasks),
            "source": Trial(data.source_domain, data.target_tasks),
            "proxy": Trial(data.target_domain, data.proxies),
            "proxy_source": Trial(data.source_domain, data.proxies),
        }

    def build_policy(self) -> PortablePolicy:
        """The policy, untrained, for the domains, tasks and statistics of the data."""
        return self.policy(self.data.specs, self.data.tasks, self.data.statistics())


def check_roles(domains: Mapping[str, Domain], source: str, target: str) -> None:
    """Source and target domain have to be two domains of the experiment.

    Raises:
        ConfigError: If they are not.
    """
    for key, name in (("source_domain", source), ("target_domain", target)):
        if name not in domains:
            raise ConfigError(f"--data.{key} is {name!r}; the domains of this experiment are {', '.join(domains)}")
    if source == target:
        raise ConfigError(f"source and target domain are both {source!r}; set two different ones")
