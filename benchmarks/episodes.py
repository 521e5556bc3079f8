"""100 episodes of a simulator: all at once, beside bare ``mj_step`` on the same states and a loop of one by one.

A policy of random weights, PLP at its defaults, acts: on all observations at once, or on one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
import torch

from benchmarks.measuring import Options, Row, at_least, at_most, in_turn, ratio, timed
from datamodules.problem import TransferProblem
from plp_lightning.envs.base import Simulator
from plp_lightning.envs.engine import Engine
from plp_lightning.envs.native import STATE
from plp_lightning.methods.plp.policy import PortablePolicy

EPISODES = 100
DOMAIN, OTHER = "domain", "other"
OURS, STEPPING, BARE, ONE_BY_ONE = "all at once", "stepping, processor", "bare mj_step", "one by one"


class Together:
    """100 episodes of a simulator, and a policy for them."""

    def __init__(self, simulator: Simulator) -> None:
        torch.manual_seed(0)
        names, self.simulator, self.rows = simulator.tasks.names, simulator, np.arange(EPISODES)
        specs = [simulator.spec(name) for name in (DOMAIN, OTHER)]
        self.policy = PortablePolicy(TransferProblem(specs, names, DOMAIN, OTHER)).eval()
        tasks = [names[i % len(names)] for i in self.rows]
        self.task, self.act = tasks[0], self.policy.actor(DOMAIN, tasks)
        self.seen = simulator.reset(tasks, self.rows.tolist())
        self.actions = self.act(self.seen, self.rows)

    def step(self) -> None:
        """Act and step, all at once."""
        self.actions = self.act(self.seen, self.rows)
        self.seen = self.simulator.step(self.actions, self.rows).observation

    def step_alone(self) -> None:
        """Step with the last actions."""
        self.simulator.step(self.actions, self.rows)

    def act_on_one(self) -> np.ndarray:
        """Give the action ``(A,)`` for the first observation."""
        action: np.ndarray = self.policy.act(self.seen.take(slice(1)), DOMAIN, self.task)[0]
        return action


def compared(
    title: str,
    together: Together,
    bare: Callable[[], object],
    one: Callable[[np.ndarray], object],
    options: Options,
    rounds: int,
    alone: Callable[[], object] | None = None,
    share: int = 10,
) -> Iterator[Row]:
    """Rows of all at once against one by one on the wall's clock, and of stepping against bare physics.

    The latter is compared in the processor's time of all threads together, so that threads hide nothing there.

    Args:
        title: What is stepped.
        together: All episodes by this project.
        bare: The physics of a control step, of all, and nothing else.
        one: Steps one episode by the simulator's own environment.
        options: What is asked for.
        rounds: Rounds of the full form.
        alone: Steps all by this project without what is no physics, if that does more.
        share: One of so many episodes is stepped one by one.
    """
    ways = {
        OURS: timed(together.step),
        STEPPING: timed(alone or together.step_alone, clock=time.process_time),
        BARE: timed(bare, clock=time.process_time),
        ONE_BY_ONE: lambda: EPISODES * timed(lambda: one(together.act_on_one()), EPISODES // share)(),
    }
    times = in_turn(ways, options.pick(rounds, max(2, rounds // 10)), warm=2)  # the first ones compile
    title = f"{EPISODES} episodes, {title}"
    yield ratio(f"{title}: {ONE_BY_ONE} / {OURS}", times, ONE_BY_ONE, OURS, at_least(5.0))
    yield ratio(f"{title}: {STEPPING} / {BARE}", times, STEPPING, BARE, at_most(1.5))


def hold(engine: Engine[Any], data: mujoco.MjData, substeps: int, forward: bool = False) -> None:
    """One control step of every state, with the controls that it holds, by MuJoCo's Python bindings alone.

    With ``forward`` forces are computed first, as environments do that set a state.
    """
    for state in engine.states:
        mujoco.mj_setState(engine.model, data, state, STATE)
        if forward:
            mujoco.mj_forward(engine.model, data)
        mujoco.mj_step(engine.model, data, nstep=substeps)
