from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datamodules.types import Observation
from plp_lightning.envs.base import Step
from plp_lightning.envs.rollout import Actor, Episodes, Observer, rollout
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert


class Scripted(LinearPoint):
    """Counts its steps: seed 100 s + i is solved from step s on and diverges in step i; 0 is never."""

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        super().reset(tasks, seeds)
        self.solved, self.fails = np.divmod(np.array(seeds), 100)
        self.t = np.zeros(len(tasks), dtype=int)
        return self._observe(np.arange(len(tasks)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> object:
        self.t[episodes] += 1
        step = super().step(actions, episodes)
        t, invalid = self.t[episodes], self.t[episodes] == self.fails[episodes]
        solved = self.solved[episodes]
        return step._replace(success=(t >= solved) & (solved > 0) & ~invalid, invalid=invalid)


def still(seen: list[list[int]]) -> Actor:
    def act(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        assert len(observation.state) == len(episodes)
        seen.append(episodes.tolist())
        return np.zeros((len(episodes), 2))

    return act


def run(seeds: list[int], hold_steps: int = 0, horizon: int = 6) -> tuple[Episodes, list[list[int]]]:
    seen: list[list[int]] = []
    return rollout(Scripted(1, horizon=horizon), still(seen), ["goal_0"] * len(seeds), seeds, hold_steps), seen


def test_episodes_end_at_success_divergence_or_the_horizon() -> None:
    episodes, seen = run([300, 2, 0, 600, 700])
    assert episodes.success.tolist() == [True, False, False, True, False]
    assert episodes.invalid.tolist() == [False, True, False, False, False]
    assert episodes.steps.tolist() == [3, 2, 6, 6, 6]
    assert seen == [[0, 1, 2, 3, 4]] * 2 + [[0, 2, 3, 4]] + [[2, 3, 4]] * 3


def test_nothing_is_stepped_once_all_episodes_are_over() -> None:
    assert run([200, 100])[1] == [[0, 1], [0]]


@pytest.mark.parametrize(("hold_steps", "steps"), [(0, 3), (2, 5), (9, 6)])
def test_an_episode_lingers_after_its_first_success(hold_steps: int, steps: int) -> None:
    episodes, seen = run([300], hold_steps)
    assert len(seen) == steps
    assert episodes.success.tolist() == [True]
    assert episodes.steps.tolist() == [3]


def test_an_episode_that_diverges_while_it_lingers_has_failed() -> None:
    episodes, _ = run([305, 304, 303], hold_steps=3)
    assert episodes.success.tolist() == [False, False, False]
    assert episodes.invalid.tolist() == [True, True, True]
    assert episodes.steps.tolist() == [5, 4, 3]
    assert run([306], hold_steps=1)[0].success.tolist() == [True]


def test_invalid_episodes_stay_in_the_count() -> None:
    episodes, _ = run([1, 1, 1])
    assert len(episodes.success) == len(episodes.invalid) == len(episodes.steps) == 3
    assert episodes.invalid.all()


def noisy_expert(simulator: LinearPoint, tasks: list[str], seeds: list[int]) -> Actor:
    """The expert, led astray at each state by a number that depends on that state alone."""
    expert = LinearPointExpert()
    expert.begin(simulator, tasks, seeds)

    def act(observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return expert.act(observation, episodes) + np.sin(40 * observation.state[:, :2])

    return act


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 1000)), min_size=1, max_size=8), st.integers(0, 3))
def test_an_outcome_does_not_depend_on_what_else_is_run(pairs: list[tuple[int, int]], hold_steps: int) -> None:
    tasks, seeds = [f"goal_{task}" for task, _ in pairs], [seed for _, seed in pairs]

    def outcome(tasks: list[str], seeds: list[int]) -> list[tuple[bool, bool, int]]:
        simulator = LinearPoint(2, horizon=25)
        got = rollout(simulator, noisy_expert(simulator, tasks, seeds), tasks, seeds, hold_steps)
        return list(zip(got.success.tolist(), got.invalid.tolist(), got.steps.tolist(), strict=True))

    together = outcome(tasks, seeds)
    assert together == [outcome([task], [seed])[0] for task, seed in zip(tasks, seeds, strict=True)]
    assert together == outcome(tasks[::-1], seeds[::-1])[::-1]


def test_the_expert_solves_every_task_from_every_start() -> None:
    simulator = LinearPoint(2)
    expert, tasks, seeds = LinearPointExpert(), list(simulator.tasks.names) * 5, list(range(40))
    expert.begin(simulator, tasks, seeds)
    assert rollout(simulator, expert.act, tasks, seeds).success.all()


class Diary(Observer):
    """Writes down everything that it hears."""

    def begin(self, tasks: Sequence[str], seeds: Sequence[int], observation: Observation[np.ndarray]) -> None:
        self.tasks, self.seeds, self.states = tuple(tasks), tuple(seeds), [observation.state]
        self.steps: list[tuple[np.ndarray, Step, list[int]]] = []

    def step(self, actions: np.ndarray, step: Step, episodes: np.ndarray) -> None:
        self.steps.append((actions, step, episodes.tolist()))
        self.states.append(step.observation.state)

    def end(self, outcome: Episodes) -> None:
        self.outcome = outcome


def test_observers_hear_everything_from_the_first_observation_to_the_one_after_the_last_action() -> None:
    diaries, simulator = [Diary(), Diary()], Scripted(1, horizon=6)
    seen: list[np.ndarray] = []

    def act(observation: Observation[np.ndarray], running: np.ndarray) -> np.ndarray:
        seen.append(observation.state)
        return np.full((len(running), 2), 0.1)

    tasks, seeds = ["goal_0", "goal_1", "goal_2"], [300, 2, 0]
    outcome = rollout(simulator, act, tasks, seeds, observers=diaries)
    for diary in diaries:
        assert (diary.tasks, diary.seeds, diary.outcome) == (tuple(tasks), tuple(seeds), outcome)
        assert [episodes for _, _, episodes in diary.steps] == [[0, 1, 2]] * 2 + [[0, 2]] + [[2]] * 3
        assert [(len(actions), actions[0, 0]) for actions, *_ in diary.steps] == [(3, 0.1)] * 2 + [(2, 0.1)] + [
            (1, 0.1)
        ] * 3
        assert diary.steps[1][1].invalid.tolist() == [False, True, False]
        assert diary.steps[2][1].success.tolist() == [True, False]
        assert len(diary.states) == len(seen) + 1
        np.testing.assert_array_equal(diary.states[0], seen[0])
        np.testing.assert_array_equal(diary.states[2][[0, 2]], seen[2])
    np.testing.assert_array_equal(diaries[0].states[-1], simulator._observe(np.array([2])).state)


def test_an_observer_that_does_not_care_need_not_say_so() -> None:
    simulator = Scripted(1, horizon=6)
    watched = rollout(simulator, still([]), ["goal_0"] * 2, [300, 2], observers=[Observer()])
    assert watched.steps.tolist() == run([300, 2])[0].steps.tolist()
