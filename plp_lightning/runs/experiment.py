"""Experiments as configurations describe them, with the method that is run on them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lightning.pytorch import Callback
from lightning.pytorch.loggers import Logger

from datamodules.errors import ConfigError
from datamodules.problem import TransferProblem
from datamodules.store.guard import as_name
from datamodules.store.reader import TrajectoryFile
from datamodules.transfer import TransferDataModule
from datamodules.types import DomainSpec
from plp_lightning.envs.base import Domain, Simulator
from plp_lightning.envs.faults import forgiving
from plp_lightning.envs.rollout import Observer
from plp_lightning.evaluation.scores import JointScore
from plp_lightning.evaluation.simulation import EvalSetting, Outcome, evaluate_all
from plp_lightning.evaluation.within import evaluate_within
from plp_lightning.methods.phase import Phase
from plp_lightning.methods.policy import AligningPolicy, Policy
from plp_lightning.pictures.reenactment import Reenactment
from plp_lightning.runs.collection import ExpertCollector
from plp_lightning.runs.plans import CollectionConfig, EvaluationPlan, HandoverPlan

PolicyFactory = Callable[[TransferProblem], Policy]
PhaseFactory = Callable[[Policy], Phase[Any]]
LoggerFactory = Callable[[Path, str], list[Logger]]
"""Builds the loggers of one phase, given its folder and a title that tells it from all others."""


@dataclass(frozen=True)
class Method:
    """An ordered list of phases that train one policy."""

    name: str
    policy: PolicyFactory
    phases: Mapping[str, PhaseFactory]  # By name, in the order in which they are run


@dataclass(frozen=True)
class Experiment:
    """Everything that a run needs, built from its configuration."""

    name: str
    method: Method
    seed: int
    threads: int
    cuda_graphs: bool
    run_root: Path
    domains: Mapping[str, Domain]
    data: TransferDataModule
    handover: HandoverPlan
    evaluation: EvaluationPlan
    score: JointScore | None
    callbacks: Sequence[Callback]
    trainer: Mapping[str, Any]  # Arguments of Lightning's Trainer
    loggers: LoggerFactory  # Those beside a run's own
    config: str  # The resolved configuration as YAML

    @property
    def run_path(self) -> Path:
        """``<run_root>/<experiment>/<method>/<target task>/seed_<n>``; a sentence becomes a name there."""
        return self.run_root / self.name / self.method.name / as_name(self.data.target_task) / f"seed_{self.seed}"

    @property
    def simulators(self) -> dict[str, Simulator]:
        """Simulators by domain, of those that have one."""
        return {name: domain.simulator for name, domain in self.domains.items() if domain.simulator is not None}

    @property
    def reenactment(self) -> Reenactment:
        """Draws what demonstrations show, as they were collected."""
        collector = self.data.collector
        collection = collector.collection if isinstance(collector, ExpertCollector) else CollectionConfig()
        return Reenactment(self.simulators, collection.noise, collection.noise_steps, collection.random_start_steps)

    @property
    def eval_settings(self) -> dict[str, EvalSetting]:
        """Episodes that are run: the target task and the proxy tasks, in target and source domain."""
        data = self.data
        return {
            "target": EvalSetting(data.target_domain, data.target_tasks),
            "source": EvalSetting(data.source_domain, data.target_tasks),
            "proxy": EvalSetting(data.target_domain, data.proxy_tasks),
            "proxy_source": EvalSetting(data.source_domain, data.proxy_tasks),
        }

    def eval_settings_of(self, policy: Policy) -> dict[str, EvalSetting]:
        """The trials in domains that a policy acts in and that are simulated."""
        possible = self.simulators.keys() & {*policy.acts_in}
        return {name: trial for name, trial in self.eval_settings.items() if trial.domain in possible}

    @property
    def specs(self) -> list[DomainSpec]:
        """Domains as simulators show them, or else the file: states ``(O,)``, images ``(H, W, C)`` and so on."""
        shown = {name: simulator.spec(name) for name, simulator in self.simulators.items()}
        if shown.keys() < self.domains.keys():
            with TrajectoryFile.open(self.data.path) as file:
                shown = {name: file.spec(name) for name in self.domains} | shown
        return [shown[name] for name in self.domains]

    @property
    def unscaled_problem(self) -> TransferProblem:
        """Domains and tasks, without the statistics that only the data have."""
        return TransferProblem(self.specs, self.data.tasks, self.data.source_domain, self.data.target_domain)

    def build_policy(self) -> Policy:
        """The policy, untrained, for the simulators' domains, and the tasks and statistics of the data."""
        return self.method.policy(replace(self.unscaled_problem, statistics=self.data.statistics()))

    def evaluate(
        self,
        policy: Policy,
        episodes: int | None = None,
        seed: int | None = None,
        observers: Mapping[str, Sequence[Observer]] | None = None,
    ) -> dict[str, Outcome]:
        """Outcome of every trial of a policy at the end of training.

        Args:
            policy: The trained policy, in eval mode.
            episodes: Episodes of each trial; those of the plan if not given.
            seed: Seed of the initial states; that of the run if not given.
            observers: By trial: further observers of its episodes.
        """
        episodes = self.evaluation.final_episodes if episodes is None else episodes
        seed = self.seed if seed is None else seed
        settings, metrics = self.eval_settings_of(policy), self.evaluation.metrics
        found = evaluate_all(policy, self.simulators, settings, episodes, seed, metrics, observers)
        return evaluate_within(metrics, found, policy, self.simulators, settings, episodes, seed)

    def alignment(self, policy: Policy) -> dict[str, float]:
        """Alignment scores of a policy at the end of a phase; empty without a score or anything to score.

        Scores for which a simulator fails are left away.
        """
        scores = dict[str, float]()
        if self.score is None or not isinstance(policy, AligningPolicy):
            return scores
        for measure in (self.score, self.score.of_target):
            with forgiving("alignment scores that need it are left away"):
                scores |= measure(policy, self.data, self.simulators)
        return scores


NAME = re.compile(r"(?!\.+$)[\w.-]{1,64}", re.ASCII)
"""Names of folders: no separators, no way out of the folder above."""


def check_names(names: Mapping[str, str]) -> None:
    """Refuse, by a :class:`ConfigError`, names of folders that would not stay below the run root."""
    for key, name in names.items():
        if not NAME.fullmatch(name):
            raise ConfigError(f"{key} is {name!r}; expected up to 64 letters, digits, '.', '_' and '-'; rename it")
