"""Success of the same episodes in a metric's own simulator, beside their success."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.simulation import Acting, EvalSetting, Outcome, evaluate_all


def evaluate_within(
    metrics: Sequence[BehaviourMetric],
    outcomes: Mapping[str, Outcome],
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
) -> dict[str, Outcome]:
    """Outcomes by trial, with what the same episodes come to in the simulators that metrics have of their own."""
    found = dict(outcomes)
    for metric in metrics:
        made = {domain: metric.own_simulator(simulator) for domain, simulator in simulators.items()}
        worlds = {domain: simulator for domain, simulator in made.items() if simulator is not None}
        own = {name: trial for name, trial in trials.items() if trial.domain in worlds}
        for name, outcome in evaluate_all(policy, worlds, own, episodes, seed).items():
            told = {**found[name].behaviour, metric.name: outcome.success}
            found[name] = replace(found[name], behaviour=told)
    return found
