"""Success rates of a policy in the domains' simulators, on the target task and on proxy tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from datamodules.errors import ConfigError
from datamodules.specs import difference
from datamodules.streams import Purpose, episode_seed
from datamodules.types import Actor
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import SimulatorError, tell_once
from plp_lightning.envs.rollout import Episodes, Observer, rollout
from plp_lightning.evaluation.behaviour import BehaviourMetric, SuccessWithin
from plp_lightning.evaluation.statistics import success_interval
from plp_lightning.methods.policy import Policy, where_it_acts

TOGETHER = 100
"""Most episodes of several trials that run at once."""


class Acting(Protocol):
    """All that an evaluation asks of a policy."""

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        """The actor in episodes of ``tasks`` that begin now."""
        ...


@dataclass(frozen=True)
class Outcome:
    """Result of one set of episodes."""

    success: float  # share of successful episodes; invalid ones count as failed
    episodes: int  # number that were run
    invalid: int  # number that diverged, or in which the simulator raised
    interval: tuple[float, float]  # 95 % Wilson interval of the success rate
    behaviour: Mapping[str, float] = field(default_factory=dict)  # without metrics that have nothing to tell

    @classmethod
    def of(cls, episodes: Episodes, metrics: Sequence[BehaviourMetric] = ()) -> Outcome:
        """Count and measure the outcome ``(E,)`` of episodes."""
        count, solved = len(episodes.success), int(episodes.success.sum())
        behaviour = {metric.name: value for metric in metrics if (value := metric.value(episodes)) is not None}
        invalid, interval = int(episodes.invalid.sum()), success_interval(solved, count)
        return cls(solved / count, count, invalid, interval, behaviour)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, the metrics of behaviour beside success."""
        counts = {name: value for name, value in vars(self).items() if name != "behaviour"}
        return {**counts, **self.behaviour, "interval": list(self.interval)}


@dataclass(frozen=True)
class EvalSetting:
    """Episodes to run: a domain and the tasks that take turns in it."""

    domain: str
    tasks: tuple[str, ...]

    def in_turn(self, purpose: Purpose, seed: int, episodes: int) -> tuple[list[str], list[int]]:
        """Task and seed of each episode; the tasks take turns."""
        tasks = [self.tasks[i % len(self.tasks)] for i in range(episodes)]
        return tasks, [episode_seed(purpose, seed, self.domain, t, i // len(self.tasks)) for i, t in enumerate(tasks)]


def evaluate(
    policy: Acting,
    simulator: Simulator,
    trial: EvalSetting,
    episodes: int,
    seed: int,
    metrics: Sequence[BehaviourMetric] = (),
    observers: Sequence[Observer] = (),
) -> Outcome:
    """Run so many ``episodes`` of a trial at once; the tasks take turns.

    Episode i always begins in the same state for a given ``seed``, whatever else is run. If the simulator raises,
    episodes that still run are invalid, and a line on standard error says why.

    Raises:
        SimulatorError: If the simulator raised before any episode ended: that is no success rate of 0.
        UserError: If the policy knows the domain as another than the simulator shows, or the user can mend what the
            simulator refuses.
    """
    _check_known(policy, simulator, trial.domain)
    tasks, seeds = trial.in_turn("evaluate", seed, episodes)
    faults, watching = list[SimulatorError](), [*metrics, *observers]
    actor = where_it_acts(policy).actor(trial.domain, tasks)
    found = rollout(simulator, actor, tasks, seeds, observers=watching, on_fault=faults.append)
    if faults and found.invalid.all():
        cause, consequence = faults[0].__cause__ or faults[0], f"; no episode in domain {trial.domain!r} came to an end"
        raise SimulatorError(simulator, cause, f"{consequence}: mend the simulator, then go on")
    for fault in faults:
        tell_once(fault, f"its episodes in domain {trial.domain!r} that still ran are invalid")
    return Outcome.of(found, metrics)


def _check_known(policy: Acting, simulator: Simulator, domain: str) -> None:
    if isinstance(policy, Policy):
        shown = simulator.spec(domain).to_dict()
        if told := difference(policy.domains[domain].to_dict(), shown, "policy"):
            remedy = "take the simulator that it was trained for"
            raise ConfigError(f"domain {domain!r} has {told}, as its simulator has: {remedy}")


def evaluate_all(
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
    metrics: Sequence[BehaviourMetric] = (),
    observers: Mapping[str, Sequence[Observer]] | None = None,
) -> dict[str, Outcome]:
    """Outcome of every trial by its name; ``simulators`` are by domain, ``observers`` by trial."""
    watching, acting = observers or {}, where_it_acts(policy)
    return {
        name: evaluate(acting, simulators[trial.domain], trial, episodes, seed, metrics, watching.get(name, ()))
        for name, trial in trials.items()
    }


def evaluate_quickly(
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
    metrics: Sequence[BehaviourMetric] = (),
) -> dict[str, Outcome]:
    """What :func:`evaluate_all` gives, up to rounding of actions: trials of a domain run together if they are short.

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
    _check_known(policy, simulator, domain)
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


def evaluate_within(
    metrics: Sequence[SuccessWithin],
    outcomes: Mapping[str, Outcome],
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
) -> dict[str, Outcome]:
    """Outcomes by trial, with what the same episodes come to nearer to their goals beside; the others as they are."""
    found = dict(outcomes)
    for metric in metrics:
        closer = {name: world for name, known in simulators.items() if (world := metric.simulator(known)) is not None}
        own = {name: trial for name, trial in trials.items() if trial.domain in closer}
        for name, outcome in evaluate_all(policy, closer, own, episodes, seed).items():
            told = {**found[name].behaviour, metric.name: outcome.success}
            found[name] = replace(found[name], behaviour=told)
    return found
