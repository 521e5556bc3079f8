from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import tiny
import torch

from datamodules.streams import episode_seed
from datamodules.types import Actor, Observation, ObservationKey
from plp_lightning.envs.base import Step
from plp_lightning.envs.rollout import Episodes
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.evaluation.behaviour import BehaviourMetric, StepsToSuccess
from plp_lightning.evaluation.simulation import (
    EvalSetting,
    Outcome,
    evaluate,
    evaluate_all,
)
from plp_lightning.evaluation.statistics import success_interval
from plp_lightning.evaluation.together import TOGETHER, evaluate_quickly
from plp_lightning.methods import ContextualPolicy
from plp_lightning.methods.plp import PortablePolicy
from plp_lightning.methods.policy import Policy, where_it_acts

TASKS = LinearPoint(1).tasks.names


class Clever:
    """Solves the tasks that it knows, stands still in the others, and gives NaN for ``forbidden``."""

    def __init__(self, simulator: LinearPoint, known: Sequence[str], forbidden: str = "") -> None:
        self.simulator, self.known, self.forbidden = simulator, known, forbidden
        self.calls: list[tuple[str, int, np.ndarray]] = []

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        return lambda observation, running: self.act(observation, domain, [tasks[i] for i in running])

    def act(self, observation: Observation[np.ndarray], domain: str, task: Sequence[str]) -> np.ndarray:
        self.calls.append((domain, len(task), observation.state))
        goals = np.array([self.simulator.goal(name) for name in task])
        point = self.simulator.shared_position(observation.state)
        actions = (2 * (goals - point)) @ self.simulator.rotation.T
        actions[[name not in self.known for name in task]] = 0
        actions[[name == self.forbidden for name in task]] = np.nan
        return actions


class Watched(LinearPoint):
    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.asked = list(zip(tasks, seeds, strict=True))
        return super().reset(tasks, seeds)


def test_invalid_episodes_count_as_failed_and_are_never_dropped() -> None:
    simulator = LinearPoint(1)
    policy = Clever(simulator, ["goal_0", "goal_1"], forbidden="goal_2")
    found = evaluate(policy, simulator, EvalSetting("flat", ("goal_0", "goal_2", "goal_5")), 12, seed=0)
    assert (found.success, found.episodes, found.invalid) == (pytest.approx(4 / 12), 12, 4)
    assert found.interval == success_interval(4, 12)


def test_an_episode_that_was_solved_and_diverged_is_no_success() -> None:
    episodes = Episodes(np.array([True, False]), np.array([False, True]), np.array([3, 4]))
    assert Outcome.of(episodes).success == 0.5


def test_tasks_take_turns_with_seeds_of_evaluation() -> None:
    simulator = Watched(1)
    evaluate(Clever(simulator, TASKS), simulator, EvalSetting("flat", ("goal_3", "goal_1")), 5, seed=7)
    expected = [("goal_3", 0), ("goal_1", 0), ("goal_3", 1), ("goal_1", 1), ("goal_3", 2)]
    assert simulator.asked == [(task, episode_seed("evaluate", 7, "flat", task, i)) for task, i in expected]
    collected = {episode_seed("collect", 7, "flat", task, i) for task in TASKS for i in range(1000)}
    assert not collected & {seed for _, seed in simulator.asked}


def test_an_episode_begins_the_same_however_many_are_run() -> None:
    simulator = Watched(1)
    trial = EvalSetting("flat", ("goal_3", "goal_1"))
    begins = []
    for episodes in (2, 9):
        evaluate(Clever(simulator, TASKS), simulator, trial, episodes, seed=7)
        begins.append(simulator.asked)
    assert begins[0] == begins[1][:2]


def test_the_policy_is_called_once_for_each_time_step_on_all_running_episodes() -> None:
    simulator = LinearPoint(1, horizon=9)
    policy = Clever(simulator, ["goal_0"])
    evaluate(policy, simulator, EvalSetting("flat", ("goal_0", "goal_5")), 20, seed=0)
    assert len(policy.calls) == 9
    running = [count for _, count, _ in policy.calls]
    assert running[0] == 20
    assert running == sorted(running, reverse=True)
    assert all(domain == "flat" and len(state) == count for domain, count, state in policy.calls)


def test_every_trial_runs_in_its_own_domain() -> None:
    simulators = {"flat": LinearPoint(1, 3), "tall": LinearPoint(2, 5)}
    policy = Clever(simulators["tall"], ["goal_0"])
    trials = {"target": EvalSetting("tall", ("goal_0",)), "proxy": EvalSetting("tall", ("goal_4",))}
    found = evaluate_all(policy, simulators, trials, 6, seed=0)
    assert {name: outcome.success for name, outcome in found.items()} == {"target": 1.0, "proxy": 0.0}
    assert {state.shape[1] for _, _, state in policy.calls} == {5}


class Counting(BehaviourMetric):
    """Control steps of a set of episodes."""

    name = "counting"

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self.total = 0

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        self.total += len(episodes)

    def value(self, outcome: Episodes) -> float:
        return float(self.total)


class Raising(LinearPoint):
    """Raises where it is to step more episodes than one trial has."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        if len(episodes) > 6:  # two trials of six run together
            raise ValueError("too many")
        return super().step(actions, episodes)


TRIALS = {
    "target": EvalSetting("tall", ("goal_0",)),
    "source": EvalSetting("flat", ("goal_0", "goal_3")),
    "proxy": EvalSetting("tall", ("goal_4", "goal_0")),
}


def test_short_trials_of_a_domain_run_together_with_the_same_outcomes() -> None:
    simulators = {"flat": LinearPoint(2, 5, horizon=9), "tall": LinearPoint(2, 5, horizon=9)}
    policy, metrics = Clever(simulators["tall"], ["goal_0"]), [StepsToSuccess()]
    apart = evaluate_all(policy, simulators, TRIALS, 6, 0, metrics)
    calls, policy.calls = len(policy.calls), []
    together = evaluate_quickly(policy, simulators, TRIALS, 6, 0, metrics)
    assert [*together.items()] == [*apart.items()]
    assert 0 < apart["proxy"].success < 1
    assert next(count for domain, count, _ in policy.calls if domain == "tall") == 12
    assert len(policy.calls) == 2 * 9 < calls


@pytest.mark.parametrize("episodes", [6, TOGETHER])
def test_trials_run_by_themselves_where_they_are_heard_or_many(episodes: int) -> None:
    simulators = {"flat": LinearPoint(2, 5, horizon=9), "tall": LinearPoint(2, 5, horizon=9)}
    policy, metrics = Clever(simulators["tall"], ["goal_0"]), [Counting()] if episodes == 6 else []
    apart = evaluate_all(policy, simulators, TRIALS, episodes, 0, metrics)
    calls, policy.calls = len(policy.calls), []
    assert evaluate_quickly(policy, simulators, TRIALS, episodes, 0, metrics) == apart
    assert len(policy.calls) == calls


def test_a_simulator_that_raises_in_trials_together_is_asked_for_each() -> None:
    simulators = {"flat": LinearPoint(2, 5), "tall": Raising(2, 5)}
    policy = Clever(simulators["tall"], ["goal_0"])
    assert evaluate_quickly(policy, simulators, TRIALS, 6, 0) == evaluate_all(policy, simulators, TRIALS, 6, 0)


def test_outcomes_are_plain_data() -> None:
    outcome = Outcome(0.5, 4, 1, success_interval(2, 4))
    plain = outcome.to_dict()
    assert json.loads(json.dumps(plain)) == plain
    assert plain == {"success": 0.5, "episodes": 4, "invalid": 1, "interval": list(outcome.interval)}


DOMAINS = [tiny.spec("flat", 2, 2), tiny.spec("tall", 3, 2)]
SEEN = [dataclasses.replace(DOMAINS[0], observation=(ObservationKey("eye", (8, 8, 3), "image"),)), DOMAINS[1]]


class Carried(PortablePolicy):
    """Notes where it is brought; nothing can be brought from torch's "meta" device, a GPU's stand-in."""

    brought: torch.device | None = None

    def to(self, device: torch.device) -> Carried:  # type: ignore[override]
        self.brought = device
        return self


def test_without_cameras_a_policy_on_a_gpu_acts_by_a_copy_on_the_processor() -> None:
    with torch.device("meta"):
        trained = Carried(tiny.problem(DOMAINS, TASKS), latent=8, hidden=16)
    acting = where_it_acts(trained)
    assert isinstance(acting, Carried)
    assert (acting.brought, trained.brought) == (torch.device("cpu"), None)
    here = PortablePolicy(tiny.problem(DOMAINS, TASKS), latent=8, hidden=16)
    assert where_it_acts(here) is here


@pytest.mark.parametrize(
    "build",
    [
        lambda: Carried(tiny.problem(SEEN, TASKS), latent=8, hidden=16),
        lambda: ContextualPolicy(tiny.problem(DOMAINS, TASKS), 16, 4, 1, 1, feed_forward=32),
    ],
)
def test_policies_that_see_or_remember_act_where_they_are_trained(build: Callable[[], Policy]) -> None:
    with torch.device("meta"):
        trained = build()
    assert where_it_acts(trained) is trained
