"""The demonstrators of V2V against Meta-World's own policies; their success in the simulator is measured there."""

from __future__ import annotations

import warnings
from typing import cast

import numpy as np
import pytest

from datamodules.errors import UserError
from plp_lightning.envs.base import Expert, Simulator
from plp_lightning.envs.experts.tabletop import ReachExpert, WindowExpert, push, reach
from plp_lightning.envs.rendering import backend
from plp_lightning.envs.tabletop import physics
from plp_lightning.envs.tabletop.simulator import Reach, Tabletop, Window

COUNT = 200


@pytest.fixture
def hands() -> np.ndarray:
    return np.random.default_rng(0).uniform([-0.2, 0.4, 0.05], [0.2, 0.9, 0.3], (COUNT, 3))


def metaworld_actions(policy: str, hands: np.ndarray, handles: np.ndarray) -> np.ndarray:
    """What Meta-World's policy does with the hand and the handle (or goal) of each row, clipped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the policies warn that they leave [-1, 1]
        import metaworld.policies

        actor = getattr(metaworld.policies, policy)()
        rows = [
            np.concatenate([hand, [1.0], handle, np.zeros(29), handle])
            for hand, handle in zip(hands, handles, strict=True)
        ]
        return np.clip([actor.get_action(row) for row in rows], -1, 1)


@pytest.mark.parametrize("opens", [True, False])
@pytest.mark.parametrize("spread", [0.3, 0.05, 0.02])
def test_push_is_metaworlds(hands: np.ndarray, opens: bool, spread: float) -> None:
    handles = hands + np.random.default_rng(1).normal(0, spread, hands.shape)
    handles += np.array([0.03 if opens else -0.03, 0.03, 0.08]) * (spread < 0.3)  # so that near stages come up
    name = "SawyerWindowOpenV3Policy" if opens else "SawyerWindowCloseV3Policy"
    expected = metaworld_actions(name, hands, handles)
    np.testing.assert_allclose(push(hands, handles, np.full(COUNT, opens)), expected, atol=1e-6)


def test_push_mixes_opening_and_closing(hands: np.ndarray) -> None:
    opens, handles = np.arange(COUNT) % 2 == 0, hands + 0.05
    actions = push(hands, handles, opens)
    np.testing.assert_array_equal(actions[opens], push(hands[opens], handles[opens], opens[opens]))
    np.testing.assert_array_equal(actions[~opens], push(hands[~opens], handles[~opens], opens[~opens]))


def test_reach_is_metaworlds_with_the_fingertips_at_the_ball(hands: np.ndarray) -> None:
    balls = hands + np.random.default_rng(1).normal(0, 0.2, hands.shape)
    expected = metaworld_actions("SawyerReachV3Policy", hands, balls + np.array([0.0, 0.0, 0.045]))
    np.testing.assert_allclose(reach(hands, balls), expected, atol=1e-6)


@pytest.mark.parametrize(("expert", "wanted"), [(ReachExpert(), "Reach"), (WindowExpert(), "Window")])
def test_other_simulators_are_refused(expert: Expert, wanted: str) -> None:
    with pytest.raises(UserError, match=f"{wanted}Expert got simulator object; expected {wanted}, pair them so"):
        expert.begin(cast("Simulator", object()), [], [])


@pytest.mark.parametrize(("simulator", "expert"), [(Reach("front"), ReachExpert()), (Window("front"), WindowExpert())])
def test_solves_every_task(simulator: Tabletop, expert: Expert, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "choose_backend", lambda: "egl")
    monkeypatch.setattr(physics.Camera, "__init__", lambda *_: None)
    monkeypatch.setattr(physics.Camera, "image", lambda *_: None)
    tasks = list(simulator.tasks.names) * (15 // len(simulator.tasks.names))
    observation = simulator.reset(tasks, range(15))
    expert.begin(simulator, tasks, range(15))
    live, solved = np.arange(15), 0
    for _ in range(110):
        step = simulator.step(expert.act(observation, live), live)
        solved += int(step.success.sum())
        going = ~step.success
        live, observation = live[going], step.observation.take(going)
        if len(live) == 0:
            break
    assert solved == 15
