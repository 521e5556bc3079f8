from __future__ import annotations

import numpy as np
import pytest

from plp_lightning.envs.base import Domain, Step
from plp_lightning.envs.demonstrator import Demonstrator
from plp_lightning.envs.rollout import rollout
from plp_lightning.envs.synthetic import LinearPoint, LinearPointExpert


class Shaken(LinearPoint):
    """Keeps what each episode executed."""

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        for episode, action in zip(episodes.tolist(), actions, strict=True):
            self.executed.setdefault(episode, []).append(action)
        return super().step(actions, episodes)


def shakes(noise_steps: int, tasks: list[str], seeds: list[int]) -> list[np.ndarray]:
    """Noise ``(T, A)`` on each episode's actions; NaN where an action was clipped."""
    simulator = Shaken(1, 3)
    simulator.executed = {}
    demonstrator = Demonstrator(Domain(simulator, LinearPointExpert(gain=0.1)), 0.2, noise_steps)
    rollout(simulator, demonstrator.act, tasks, seeds, observers=[demonstrator])
    executed = [np.stack(simulator.executed[i]) for i in range(len(tasks))]
    wanted = [demonstrator.episode(i)[1] for i in range(len(tasks))]
    return [np.where(np.abs(e) < 1, e - w, np.nan) for e, w in zip(executed, wanted, strict=True)]


@pytest.mark.parametrize("noise_steps", [1, 3])
def test_a_draw_of_noise_lasts_as_long_as_it_is_told_to(noise_steps: int) -> None:
    (found,) = shakes(noise_steps, ["goal_1"], [5])
    assert len(found) > 6
    changes = np.abs(np.diff(found, axis=0)).max(axis=1)
    for t, change in enumerate(changes, start=1):
        assert (change > 1e-3) if t % noise_steps == 0 else (change < 1e-6)


def test_noise_is_an_episodes_own_whoever_else_is_shaken() -> None:
    alone = shakes(3, ["goal_4"], [6])[0]
    among = shakes(3, ["goal_1", "goal_4", "goal_6"], [5, 6, 7])[1]
    np.testing.assert_allclose(among, alone, atol=1e-6)


@pytest.mark.parametrize("random_start_steps", [0, 4])
def test_demonstrators_keep_what_is_seen_after_the_last_action(random_start_steps: int) -> None:
    domain = Domain(LinearPoint(1, 3), LinearPointExpert())
    tasks, seeds = ["goal_1", "goal_4", "goal_6"], [5, 6, 7]
    demonstrator = Demonstrator(domain, 0.0, random_start_steps=random_start_steps)
    outcome = rollout(domain.simulator, demonstrator.act, tasks, seeds, observers=[demonstrator])
    for index, (task, seed) in enumerate(zip(tasks, seeds, strict=True)):
        observation, actions = demonstrator.episode(index)
        assert len(observation.state) == len(actions) + 1 == outcome.steps[index] - random_start_steps + 1
        state = domain.simulator.reset([task], [seed]).state
        for drift in [demonstrator.drifts[index]] * random_start_steps:
            state = domain.simulator.step(drift[None], np.array([0])).observation.state
        for shown, action in zip(observation.state, actions, strict=False):
            np.testing.assert_array_equal(shown, state[0])
            state = domain.simulator.step(action[None], np.array([0])).observation.state
        np.testing.assert_array_equal(observation.state[-1], state[0])
