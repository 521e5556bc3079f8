"""Success at a smaller distance from the goal, measured in the same episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import yaml
from command import ROOT

from datamodules.errors import UserError
from datamodules.types import Actor, Observation
from plp_lightning.cli.config import parse
from plp_lightning.envs import PointMaze
from plp_lightning.envs.base import Simulator
from plp_lightning.evaluation.behaviour import BehaviourMetric, StepsToSuccess, SuccessWithin
from plp_lightning.evaluation.simulation import EvalSetting, Outcome, evaluate_all
from plp_lightning.evaluation.within import evaluate_within

TRIALS = {"target": EvalSetting("point", ("s0_g_1_1",))}  # from the cell beside the goal


class Beside:
    """Drives a point to a place so many metres before the goal, and stays there."""

    def __init__(self, maze: PointMaze, distance: float) -> None:
        self.place = maze.frame.centres(np.array([1.0, 1.0 + distance]))

    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
            pull = 5 * (self.place - observation.state[:, :2]) - 3 * observation.state[:, 2:]
            return np.clip(pull, -1, 1).astype(np.float32)

        return act


def outcomes(distance: float, *metrics: BehaviourMetric) -> tuple[Outcome, Outcome]:
    """The target's outcome without and with further distances."""
    maze = PointMaze("umaze")
    policy, simulators = Beside(maze, distance), {"point": maze}
    bare = evaluate_all(policy, simulators, TRIALS, 5, 0)
    return bare["target"], evaluate_within(metrics, bare, policy, simulators, TRIALS, 5, 0)["target"]


@pytest.mark.parametrize(("distance", "near"), [(0.0, 1.0), (0.1, 1.0), (0.4, 0.0)])
def test_episodes_go_on_to_the_smaller_distance_and_success_is_as_it_was(distance: float, near: float) -> None:
    bare, found = outcomes(distance, SuccessWithin(0.2))
    assert bare.success == 1.0
    assert (found.success, found.interval, found.episodes) == (bare.success, bare.interval, bare.episodes)
    assert found.behaviour == {"success_within_0.2_m": near}


def test_where_success_asks_for_as_much_nothing_is_run_again() -> None:
    bare, found = outcomes(0.0, SuccessWithin(0.5), SuccessWithin(2.0))
    assert found == bare


def test_several_distances_stand_beside_one_another() -> None:
    _, found = outcomes(0.3, SuccessWithin(0.4), SuccessWithin(0.1))
    assert found.behaviour == {"success_within_0.4_m": 1.0, "success_within_0.1_m": 0.0}


class SuccessInTime(StepsToSuccess):
    """Share of episodes that succeed in so few steps: a metric that knows nothing of distances."""

    name = "success_in_time"

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def own_simulator(self, simulator: Simulator) -> PointMaze:
        return PointMaze("umaze", horizon=self.steps)


def test_any_metric_may_have_a_simulator_of_its_own() -> None:
    bare, found = outcomes(0.0, SuccessInTime(2), StepsToSuccess())
    assert (bare.success, found.behaviour) == (1.0, {"success_in_time": 0.0})


@pytest.mark.parametrize("page", sorted(path.stem for path in (ROOT / "configs").glob("[ap]2[as]_*.yaml")))
def test_pages_of_walkers_measure_both_distances(page: str) -> None:
    experiment = parse(["--config", str(ROOT / "configs" / f"{page}.yaml")])
    radii = [metric.radius for metric in experiment.evaluation.metrics if isinstance(metric, SuccessWithin)]
    reach = {getattr(simulator, "success_radius", None) for simulator in experiment.simulators.values()}
    assert (2.0 in reach) == (radii == [0.5])
    assert len(yaml.safe_load(experiment.config)["evaluation"]["metrics"]) == 1 + len(radii)


def test_no_distance_is_one_line() -> None:
    with pytest.raises(UserError, match=r"SuccessWithin\.radius is 0; expected a number above 0; change it"):
        SuccessWithin(0)
