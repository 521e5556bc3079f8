from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from datamodules.types import Actor, Observation
from plp_lightning.envs.base import Step
from plp_lightning.envs.rollout import Episodes
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.evaluation.behaviour import BehaviourMetric, StepsToSuccess
from plp_lightning.evaluation.simulation import EvalSetting, Outcome, evaluate, evaluate_all

TRIAL = EvalSetting("flat", ("goal_0", "goal_5"))


def episodes(success: list[bool], steps: list[int]) -> Episodes:
    return Episodes(np.array(success), np.zeros(len(success), dtype=bool), np.array(steps))


def test_steps_to_success_leave_failures_out() -> None:
    assert StepsToSuccess().value(episodes([True, False, True], [3, 40, 8])) == 5.5
    assert StepsToSuccess().value(episodes([False, False], [40, 40])) is None


class Straight:
    """Goes straight to the goals that it knows, and stands still in other tasks."""

    def __init__(self, simulator: LinearPoint, known: Sequence[str]) -> None:
        self.simulator, self.known = simulator, known

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
            goals = np.array([self.simulator.goal(tasks[i]) for i in running])
            ways = 2 * (goals - self.simulator.shared_position(observation.state))
            still = np.array([tasks[i] not in self.known for i in running])
            return np.where(still[:, None], 0.0, ways) @ self.simulator.rotation.T

        return act


class Heard(BehaviourMetric):
    """Control steps that were heard of since the beginning, however episodes ended."""

    name = "heard"

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self.total = 0

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        assert len(actions) == len(step.success) == len(episodes)
        self.total += len(episodes)

    def value(self, outcome: Episodes) -> float:
        assert self.total == outcome.steps.sum()
        return float(self.total)


def test_metrics_stand_beside_success_and_begin_anew_with_every_trial() -> None:
    simulator = LinearPoint(1, horizon=20)
    policy = Straight(simulator, ["goal_0"])
    trials = {"both": TRIAL, "again": TRIAL, "none": EvalSetting("flat", ("goal_5",))}
    found = evaluate_all(policy, {"flat": simulator}, trials, 6, 0, [StepsToSuccess(), Heard()])
    assert found["both"] == found["again"]
    assert found["both"].success == 0.5
    assert 1 < found["both"].behaviour["steps_to_success"] < 20
    assert found["both"].behaviour["heard"] == 3 * found["both"].behaviour["steps_to_success"] + 3 * 20
    assert found["none"].behaviour == {"heard": 120.0}
    assert found["both"].to_dict()["steps_to_success"] == found["both"].behaviour["steps_to_success"]
    assert "steps_to_success" not in found["none"].to_dict()
    assert "behaviour" not in found["none"].to_dict()


def test_metrics_change_nothing_else() -> None:
    simulator = LinearPoint(1, horizon=20)
    policy = Straight(simulator, ["goal_0"])
    bare = evaluate(policy, simulator, TRIAL, 6, seed=3)
    watched = evaluate(policy, simulator, TRIAL, 6, seed=3, metrics=[Heard()])
    assert bare == Outcome(watched.success, watched.episodes, watched.invalid, watched.interval)


def test_a_metric_has_to_say_its_value() -> None:
    with pytest.raises(TypeError, match="abstract"):
        BehaviourMetric()  # type: ignore[abstract]
