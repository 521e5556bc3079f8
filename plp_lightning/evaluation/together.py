"""Trials of a domain in one rollout: quicker where each has few episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import SimulatorError
from plp_lightning.envs.rollout import Observer, rollout
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.simulation import Acting, EvalSetting, Outcome, check_known, evaluate_all
from plp_lightning.methods.policy import where_it_acts

TOGETHER = 100
"""Most episodes of several trials that run at once."""


def evaluate_quickly(
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
    metrics: Sequence[BehaviourMetric] = (),
) -> dict[str, Outcome]:
    """Outcomes of :func:`evaluate_all`, up to rounding of actions: trials of a domain run together if they are short.

    A policy acts on a few episodes in the same time as on twice as many, but rounds otherwise. Each trial runs by
    itself where a metric hears steps, of one set of episodes at a time, and after its simulator has raised.
    """
    found, acting = dict[str, Outcome](), where_it_acts(policy)
    apart = any(_hears_steps(metric) for metric in metrics)
    for domain in dict.fromkeys(trial.domain for trial in trials.values()):
        its, simulator = {name: t for name, t in trials.items() if t.domain == domain}, {domain: simulators[domain]}
        plan = (its, episodes, seed, metrics)
        together = {} if apart or len(its) * episodes > TOGETHER else _evaluate_together(acting, simulator, *plan)
        found |= together or evaluate_all(acting, simulator, *plan)
    return {name: found[name] for name in trials}


def _evaluate_together(
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
    metrics: Sequence[BehaviourMetric],
) -> dict[str, Outcome]:
    """Outcomes of one domain's trials in one rollout; none if the simulator raises."""
    ((domain, simulator),) = simulators.items()
    check_known(policy, simulator, domain)
    plans = [trial.in_turn("evaluate", seed, episodes) for trial in trials.values()]
    tasks, seeds = ([x for part in parts for x in part] for parts in zip(*plans, strict=True))
    faults = list[SimulatorError]()
    found = rollout(simulator, policy.actor(domain, tasks), tasks, seeds, on_fault=faults.append)
    if faults:
        return {}
    parts = (found.take(slice(start, start + episodes)) for start in range(0, len(tasks), episodes))
    return {name: Outcome.of(part, metrics) for name, part in zip(trials, parts, strict=True)}


def _hears_steps(metric: BehaviourMetric) -> bool:
    """Tell whether a metric keeps something of a set of episodes, so that it can hear one set at a time."""
    return any(getattr(type(metric), name) is not getattr(Observer, name) for name in ("begin", "step", "end"))
