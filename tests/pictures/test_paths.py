from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from datamodules.types import Actor, Observation
from plp_lightning.envs.base import Step
from plp_lightning.envs.experts.waypoint import WaypointExpert
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.envs.rollout import Episodes, rollout
from plp_lightning.envs.synthetic import LinearPoint
from plp_lightning.envs.views import FloorPlan
from plp_lightning.evaluation.simulation import EvalSetting, evaluate_all
from plp_lightning.pictures.paths import PathRecorder, Paths, path_recorders

TASKS = ["s0_g_3_1", "s1_g_1_1", "s2_g_2_3", "s0_g_2_3", "s2_g_1_1", "s1_g_3_1"]
SEEDS = [3, 4, 5, 6, 7, 8]
MIRRORED = {"swap_axes": True, "negate_actions": True}


def walked(simulator: PointMaze, wild: Sequence[int] = ()) -> tuple[PathRecorder, Episodes]:
    """The expert's episodes; the ``wild`` ones act at random instead, and rarely arrive."""
    recording, expert = PathRecorder(simulator, simulator.floor_plan()), WaypointExpert()
    rng = np.random.default_rng(0)

    def act(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        if recording.paths.positions[0].shape[0] == 1:
            expert.begin(simulator, TASKS, SEEDS)
        actions = expert.act(observation, episodes)
        lost = np.isin(episodes, wild)
        actions[lost] = np.sign(rng.normal(size=(lost.sum(), 2)))
        return actions

    return recording, rollout(simulator, act, TASKS, SEEDS, observers=[recording])


@pytest.fixture(scope="module", params=[{}, MIRRORED], ids=["plain", "mirrored"])
def walk(request: pytest.FixtureRequest) -> tuple[PathRecorder, Episodes]:
    return walked(PointMaze("umaze", horizon=200, **request.param), wild=(0, 3))


def test_paths_are_the_positions_that_stepping_by_hand_shows() -> None:
    seen, watched = PointMaze("umaze", **MIRRORED), PointMaze("umaze", **MIRRORED)
    recorder = PathRecorder(watched, watched.floor_plan())
    rng, everyone, second = np.random.default_rng(1), np.arange(2), np.array([1])
    states = [[state] for state in seen.reset(TASKS[:2], SEEDS[:2]).state]
    recorder.begin(TASKS[:2], SEEDS[:2], watched.reset(TASKS[:2], SEEDS[:2]))
    for episodes in (everyone, everyone, second, second, second):
        actions = rng.uniform(-1, 1, (len(episodes), 2))
        recorder.step(actions, watched.step(actions, episodes), episodes)
        for episode, state in zip(episodes, seen.step(actions, episodes).observation.state, strict=True):
            states[episode].append(state)
    # This domain shows (y, x, vy, vx), and in D4RL's frame of the point row i lies at x = i - 0.2.
    for path, shown in zip(recorder.paths.positions, states, strict=True):
        np.testing.assert_allclose(path, np.array(shown)[:, [1, 0]] + 0.2, atol=1e-6)
    assert [len(path) for path in recorder.paths.positions] == [3, 6]


def test_recorded_episodes_are_those_of_the_simulator(walk: tuple[PathRecorder, Episodes]) -> None:
    watched, episodes = walk
    assert watched.paths.tasks == tuple(TASKS)
    assert watched.paths.success.tolist() == episodes.success.tolist()
    assert [len(path) - 1 for path in watched.paths.positions] == episodes.steps.tolist()
    assert 0 < episodes.success.sum() < len(TASKS), "both kinds are compared"


def test_no_path_leads_through_a_wall(walk: tuple[PathRecorder, Episodes]) -> None:
    watched, _ = walk
    places, plan = np.concatenate(watched.paths.positions), watched.plan
    gaps = np.abs(places[:, None] - plan.walls[None]).max(axis=2)
    assert (gaps > plan.side / 2).all()
    assert gaps.min() < 0.8, "some walk along a wall"


def test_solved_paths_alone_end_at_their_goals(walk: tuple[PathRecorder, Episodes]) -> None:
    paths, plan = walk[0].paths, walk[0].plan
    goals = np.array([plan.goals[task] for task in paths.tasks])
    rest = [np.linalg.norm(path - goal, axis=1) for path, goal in zip(paths.positions, goals, strict=True)]
    arrived = [distance[-1] <= plan.radius + 1e-6 for distance in rest]
    assert arrived == paths.success.tolist()
    assert all((distance[:-1] > plan.radius - 1e-6).all() for distance in rest)


def test_a_new_rollout_forgets_the_one_before() -> None:
    watched, _ = walked(PointMaze("umaze"))
    watched.begin(["s0_g_3_1"], [1], PointMaze("umaze").reset(["s0_g_3_1"], [1]))
    assert [path.shape for path in watched.paths.positions] == [(1, 2)]
    assert watched.paths.success.tolist() == [False]


class Scripted(LinearPoint):
    """Solves and diverges by script: a row ``(success, invalid)`` for each step of the only episode."""

    script: Sequence[tuple[bool, bool]] = ()

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        (success, invalid), self.script = self.script[0], self.script[1:]
        return super().step(actions, episodes)._replace(success=np.array([success]), invalid=np.array([invalid]))


@pytest.mark.parametrize(
    ("script", "solved"),
    [
        ([(False, False), (True, False)], True),
        ([(True, False), (False, False), (False, False)], True),
        ([(True, False), (False, True)], False),
        ([(True, True)], False),
    ],
)
def test_success_is_what_a_rollout_calls_so(script: list[tuple[bool, bool]], solved: bool) -> None:
    simulator = Scripted(1, horizon=len(script))
    simulator.script = script
    watched = PathRecorder(simulator, FloorPlan(np.zeros((1, 2)), 1.0, {}, 1.0))
    still = np.zeros((1, 2))
    episodes = rollout(simulator, lambda seen, running: still, ["goal_0"], [0], len(script), [watched])
    assert watched.paths.success.tolist() == episodes.success.tolist() == [solved]


def test_floor_plans_are_the_drawing_for_all_bodies_and_frames() -> None:
    drawing = ["#####", "#   #", "### #", "#   #", "#####"]
    marked = {(i, j) for i, row in enumerate(drawing) for j, mark in enumerate(row) if mark == "#"}
    for maze in (PointMaze("umaze", radius=0.25), WalkerMaze("umaze", radius=0.25, frame="gymnasium")):
        plan = maze.floor_plan()
        assert {tuple(block) for block in plan.walls} == marked
        assert (plan.side, plan.radius, plan.goals["s0_g_3_1"]) == (1.0, 0.25, (3.0, 1.0))
        start = maze.shared_position(maze.reset(["s2_g_1_1"], [0]).state)[0]
        assert tuple(np.rint(start)) in {(3, 1), (3, 2)}


class Still:
    def actor(self, domain: str, tasks: Sequence[str]) -> Actor:
        return lambda observation, running: np.zeros((len(running), 2))


def test_only_the_trials_of_domains_with_a_floor_plan_are_recorded() -> None:
    simulators = {"maze": PointMaze("umaze", horizon=2), "flat": LinearPoint(1, horizon=2)}
    trials = {
        "a": EvalSetting("maze", ("s0_g_3_1",)),
        "b": EvalSetting("maze", ("s2_g_1_1",)),
        "c": EvalSetting("flat", ("goal_1",)),
    }
    found = path_recorders(simulators, {name: trials[name] for name in ("a", "c")})
    assert list(found) == ["a"]
    outcomes = evaluate_all(
        Still(), simulators, trials, 3, seed=0, observers={name: [recorder] for name, recorder in found.items()}
    )
    assert outcomes == evaluate_all(Still(), simulators, trials, 3, seed=0)
    paths: Paths = found["a"].paths
    assert paths.tasks == ("s0_g_3_1",) * 3
    assert [path.shape for path in paths.positions] == [(3, 2)] * 3
