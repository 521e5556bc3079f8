"""``mujoco.rollout`` in the place of this project's engine: its speed, and how far apart states end.

Both are called once for each control step, on as many threads, and take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from benchmarks.measuring import Options, Row, in_turn, ratio, timed
from plp_lightning.envs.cores import available_cores
from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze

BODIES: dict[str, Callable[[], Maze]] = {
    "point": lambda: PointMaze("medium"),
    "ant": lambda: WalkerMaze("medium"),
    "spider": lambda: WalkerMaze("medium", legs=6),
}
EPISODES = 100
THEIRS, OURS = "mujoco.rollout", "ours"


class Native:
    """States ``(E, S)`` that ``mujoco.rollout`` advances; it returns neither warm starts nor what diverged.

    Args:
        model: What is simulated.
        states: Where it begins: time, positions and velocities.
        warmstart: The solver's first warm start ``(E, V)``.
        substeps: Physics steps of a control step.
    """

    def __init__(self, model: mujoco.MjModel, states: np.ndarray, warmstart: np.ndarray, substeps: int) -> None:
        self.states, self.warmstart, self.substeps = states.copy(), warmstart.copy(), substeps
        self.data = [mujoco.MjData(model) for _ in range(available_cores())]
        self.models, self.rollout = [model] * len(states), Rollout(nthread=len(self.data))
        self.seen = np.empty((len(states), substeps, states.shape[1]))
        self.spec = int(mujoco.mjtState.mjSTATE_CTRL)

    def step(self, controls: np.ndarray) -> None:
        """Hold ``controls (E, U)`` for a control step."""
        held = np.repeat(controls[:, None], self.substeps, axis=1)
        self.rollout.rollout(
            self.models,
            self.data,
            self.states,
            held,
            control_spec=self.spec,
            skip_checks=True,
            nstep=self.substeps,
            initial_warmstart=self.warmstart,
            state=self.seen,
        )
        self.states = self.seen[:, -1].copy()
        self.warmstart[:] = 0.0  # what rollout begins with if it is not told


def draw(controls: np.ndarray, rng: np.random.Generator) -> None:
    """Fill controls ``(E, U)`` with new ones."""
    controls[:] = rng.uniform(-1, 1, controls.shape)


def rows(options: Options) -> Iterator[Row]:
    for name, build in BODIES.items():
        maze, every = build(), np.arange(EPISODES)
        maze.reset([maze.tasks.names[i % len(maze.tasks.names)] for i in every], every.tolist())
        engine = maze._physics
        physical = slice(0, engine.qvel.stop)  # time, positions and velocities
        warm = engine.columns(mujoco.mjtState.mjSTATE_WARMSTART)
        native = Native(engine.model, engine.states[:, physical], engine.states[:, warm], maze.frame_skip)
        controls, rng = np.zeros((EPISODES, engine.model.nu)), np.random.default_rng(0)
        ways = {
            "draws": timed(partial(draw, controls, rng)),
            THEIRS: timed(partial(native.step, controls)),
            OURS: timed(partial(engine.hold, every, controls, maze.frame_skip)),
        }
        times = in_turn(ways, options.pick(200, 20), warm=2)
        apart = np.abs(engine.states[:, physical] - native.states).max()
        told = f"states are apart by {apart:.1e} at the end"
        yield ratio(f"{EPISODES} episodes, {name}: {THEIRS} / {OURS}", times, THEIRS, OURS, note=told)
