"""Success rates of a policy in the domains' simulators, on the target task and on proxy tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from datamodules.errors import ConfigError
from datamodules.specs import difference
from datamodules.streams import Purpose, episode_seed
from datamodules.types import Actor
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.faults import SimulatorError, tell_once
from plp_lightning.envs.rollout import Episodes, Observer, rollout
from plp_lightning.evaluation.behaviour import BehaviourMetric
from plp_lightning.evaluation.statistics import success_interval
from plp_lightning.methods.policy import Policy, where_it_acts


class Acting(Protocol):
    """All that an evaluation asks of a policy."""

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        """The actor in episodes of ``tasks`` that begin now."""


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
        UserError: If the policy knows the domain otherwise than the simulator shows it, or a user can mend a refusal.
    """
    check_known(policy, simulator, trial.domain)
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


def check_known(policy: Acting, simulator: Simulator, domain: str) -> None:
    """Raise a ConfigError if the policy knows the domain as another than the simulator shows."""
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
