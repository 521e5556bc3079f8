"""The demonstrator of R2R-Lift: each stage by hand, and its success in the simulator."""

from __future__ import annotations

from typing import cast, get_args

import numpy as np
import pytest

from datamodules.errors import UserError
from datamodules.types import Observation
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.experts.lift import LiftExpert
from plp_lightning.envs.lift.robots import Robot
from plp_lightning.envs.lift.simulator import Lift

OPEN = {"Sawyer": 0.0112, "UR5e": -0.027, "Panda": 0.039, "Kinova3": -0.027}
HELD = {"Sawyer": 0.0019, "UR5e": 0.43, "Panda": 0.0199, "Kinova3": 0.43}
ROBOTS: tuple[Robot, ...] = get_args(Robot)
BLOCK = np.array([-0.08, 0.12, 0.87])


def act(robot: Robot, offset: list[float], finger: float, noise: float = 0.0) -> np.ndarray:
    """The expert's action with the hand at ``offset`` from the block of task x0y2h1."""
    lift, expert = Lift(robot), LiftExpert()
    expert.begin(lift, ["x2y2h2", "x0y2h1"], [0, 0])
    spec = lift.spec("d")
    state = noise * np.random.default_rng(0).standard_normal((1, spec.state_size))
    state[0, spec.columns(["eef_pos"])] = BLOCK + offset
    state[0, spec.columns(["gripper_qpos"])[0]] = finger
    actions: np.ndarray = expert.act(Observation(state.astype(np.float32)), np.array([1]))
    return actions.reshape(4)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(
    ("offset", "held", "action"),
    [
        ([0.0, 0.0, 0.14], True, [0.0, 0.0, 0.6, 1.0]),  # 1 cm below the top of the lift, gain 3 over 5 cm
        ([0.0, 0.0, 0.0], True, [0.0, 0.0, 1.0, 1.0]),
        ([0.005, 0.0, -0.005], False, [-0.3, 0.0, 0.3, 1.0]),  # at the block: close
        ([0.0, 0.005, 0.015], False, [0.0, -0.3, -0.9, -1.0]),  # over it: descend, open
        ([0.1, -0.01, 0.06], True, [-1.0, 0.6, 0.6, -1.0]),  # closed, but on nothing: open on the way
        ([0.1, -0.01, 0.06], False, [-1.0, 0.6, 0.6, -1.0]),  # beside it and high enough: gather above
        ([0.1, -0.05, 0.04], False, [-0.9, 0.45, 1.0, -1.0]),  # beside it and low: rise first
    ],
)
def test_stages(robot: Robot, offset: list[float], held: bool, action: list[float]) -> None:
    finger = (HELD if held else OPEN)[robot]
    np.testing.assert_allclose(act(robot, offset, finger), action, atol=1e-4)


@pytest.mark.parametrize("robot", ROBOTS)
def test_nothing_but_hand_and_fingers_matters(robot: Robot) -> None:
    offset = [0.03, -0.02, 0.05]
    np.testing.assert_array_equal(act(robot, offset, OPEN[robot], noise=1.0), act(robot, offset, OPEN[robot]))


def test_other_simulators_are_refused() -> None:
    with pytest.raises(UserError, match="LiftExpert got simulator object; expected Lift"):
        LiftExpert().begin(cast("Simulator", object()), [], [])


@pytest.mark.parametrize("robot", ROBOTS)
def test_solves_every_task(robot: Robot) -> None:
    lift, expert = Lift(robot), LiftExpert()
    observation, seeds = lift.reset(lift.tasks.names, range(27)), range(27)
    expert.begin(lift, lift.tasks.names, seeds)
    live, solved = np.arange(27), 0
    for _ in range(80):
        step = lift.step(expert.act(observation, live), live)
        solved += int(step.success.sum())
        going = ~(step.success | step.invalid)
        live, observation = live[going], step.observation.take(going)
        if len(live) == 0:
            break
    assert solved >= 26
