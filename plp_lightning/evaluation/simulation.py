"""Success rates of a policy in the domains' simulators, on the target task and on proxy tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from datamodules.streams import Purpose, episode_seed
from datamodules.types import Actor
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.rollout import Episodes, rollout
from plp_lightning.evaluation.statistics import success_interval


class Acting(Protocol):
    """All that an evaluation asks of a policy."""

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        """Who acts in episodes of ``tasks`` that begin now."""
        ...


@dataclass(frozen=True)
class Success:
    """Outcome of one set of episodes.

    Args:
        success: Share of successful episodes; invalid ones count as failed.
        episodes: How many were run.
        invalid: How many diverged.
        interval: 95 % Wilson interval of the success rate.
    """

    success: float
    episodes: int
    invalid: int
    interval: tuple[float, float]

    @classmethod
    def of(cls, episodes: Episodes) -> Success:
        """Count."""
        count, solved = len(episodes.success), int(episodes.success.sum())
        return cls(solved / count, count, int(episodes.invalid.sum()), success_interval(solved, count))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {**vars(self), "interval": list(self.interval)}


@dataclass(frozen=True)
class EvalSetting:
    """Which episodes to run: a domain and the tasks that take turns in it."""

    domain: str
    tasks: tuple[str, ...]

    def in_turn(self, purpose: Purpose, seed: int, episodes: int) -> tuple[list[str], list[int]]:
        """Task and seed of each episode; the tasks take turns."""
        tasks = [self.tasks[i % len(self.tasks)] for i in range(episodes)]
        return tasks, [episode_seed(purpose, seed, self.domain, t, i // len(self.tasks)) for i, t in enumerate(tasks)]


def evaluate(policy: Acting, simulator: Simulator, trial: EvalSetting, episodes: int, seed: int) -> Success:
    """Run ``episodes`` of a trial at once.

    Episode i always begins in the same state for a given seed, whatever else is run.

    Args:
        policy: Whose actor is called once for each time step on the batch of running episodes.
        simulator: The trial's domain.
        trial: Domain and tasks.
        episodes: How many; tasks take turns.
        seed: Seed of the run.
    """
    tasks, seeds = trial.in_turn("evaluate", seed, episodes)
    return Success.of(rollout(simulator, policy.actor(trial.domain, tasks), tasks, seeds))


def evaluate_all(
    policy: Acting,
    simulators: Mapping[str, Simulator],
    trials: Mapping[str, EvalSetting],
    episodes: int,
    seed: int,
    recorders: Mapping[str, Simulator] | None = None,
) -> dict[str, Success]:
    """Outcome of every trial, by its name.

    Args:
        policy: Who acts.
        simulators: By domain.
        trials: By name.
        episodes: Episodes of each trial.
        seed: Seed of the run.
        recorders: By trial: who stands in for its domain's simulator, to watch these episodes alone.
    """
    stages = {name: simulators[trial.domain] for name, trial in trials.items()} | dict(recorders or {})
    return {name: evaluate(policy, stages[name], trial, episodes, seed) for name, trial in trials.items()}
