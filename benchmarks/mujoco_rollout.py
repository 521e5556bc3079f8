"""A test whether ``mujoco.rollout`` could step the mazes: its speed beside this project's engine, and what it changes.

Run from the repository: ``python benchmarks/mujoco_rollout.py [--episodes 100] [--steps 200]``. Both are called once
for each control step, on as many threads, and take turns, so that a busy machine slows both alike.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from plp_lightning.envs.base import available_cores
from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze

BODIES: dict[str, Callable[[], Maze]] = {
    "point": lambda: PointMaze("medium"),
    "ant": lambda: WalkerMaze("medium"),
    "spider": lambda: WalkerMaze("medium", legs=6),
}


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


def measure(name: str, episodes: int, steps: int) -> str:
    """A line of the table for one body."""
    maze, rows = BODIES[name](), np.arange(episodes)
    maze.reset([maze.tasks.names[i % 100 % len(maze.tasks.names)] for i in rows], rows.tolist())
    engine = maze._physics
    physical = slice(0, engine.qvel.stop)  # time, positions and velocities
    warm = engine.columns(mujoco.mjtState.mjSTATE_WARMSTART)
    native = Native(engine.model, engine.states[:, physical], engine.states[:, warm], maze.frame_skip)
    rng, seconds, apart = np.random.default_rng(0), np.zeros((2, 2)), np.zeros(steps)
    for t in range(steps):
        controls = rng.uniform(-1, 1, (episodes, engine.model.nu))
        ways = partial(engine.hold, rows, controls, maze.frame_skip), partial(native.step, controls)
        times = [(time.perf_counter(), time.process_time())]
        for way in ways:
            way()
            times.append((time.perf_counter(), time.process_time()))
        if t > 0:  # the first step compiles
            seconds += np.diff(times, axis=0)
        apart[t] = np.abs(engine.states[:, physical] - native.states).max()
    first = int(np.argmax(apart > 0)) + 1 if apart.any() else None
    wall, processor = seconds[1] / seconds[0]
    return (
        f"{name:7} mujoco.rollout takes {wall:.2f}x as long ({processor:.2f}x processor time); "
        f"states differ from step {first} on, by {apart[-1]:.1e} after {steps}"
    )


def main() -> None:
    """Measure all bodies and print ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--steps", type=int, default=200)
    options = parser.parse_args()
    for name in BODIES:
        print(measure(name, options.episodes, options.steps), flush=True)


if __name__ == "__main__":
    main()
