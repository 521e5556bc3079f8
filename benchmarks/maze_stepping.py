"""The speed at which the mazes step, beside bare ``mj_step`` on the same states and Gymnasium-Robotics one by one.

Run from the repository: ``python benchmarks/maze_stepping.py [--episodes 100]``. Actions are random; no episode
ends early. The three ways of stepping take turns every few steps, so that a busy machine slows all of them alike.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from plp_lightning.envs.maze.base import Maze
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze
from plp_lightning.envs.native import STATE

BODIES: dict[str, tuple[Callable[[], Maze], int, str]] = {
    "point": (lambda: PointMaze("medium", frame="gymnasium"), 600, "PointMaze_Medium-v3"),
    "ant": (lambda: WalkerMaze("medium", frame="gymnasium"), 1000, "AntMaze_Medium-v4"),
    "spider": (lambda: WalkerMaze("medium", legs=6, frame="gymnasium"), 1000, ""),
}
COMPARE_EVERY = 20
"""The slow loops step in one of so many control steps."""
GYMNASIUM_EPISODES = 10


def timed(call: Callable[[], object]) -> np.ndarray:
    """Seconds of wall time and of processor time, all threads together, that a call takes."""
    start = time.perf_counter(), time.process_time()
    call()
    return np.array([time.perf_counter() - start[0], time.process_time() - start[1]])


def bare(maze: Maze, data: mujoco.MjData, states: np.ndarray, actions: np.ndarray) -> None:
    """One control step of every state with MuJoCo's Python bindings and nothing else."""
    model = maze._physics.model
    for state, action in zip(states, actions, strict=True):
        mujoco.mj_setState(model, data, state, STATE)
        data.ctrl[:] = action
        mujoco.mj_step(model, data, nstep=maze.frame_skip)


def measure(name: str, episodes: int) -> str:
    """A line of the table for one body."""
    build, steps, env_id = BODIES[name]
    maze, env = build(), gymnasium_env(env_id)
    rows = np.arange(episodes)
    maze.reset([maze.tasks.names[i % len(maze.tasks.names)] for i in rows], rows.tolist())
    data = mujoco.MjData(maze._physics.model)
    rng = np.random.default_rng(0)
    ours, shared, slow, gymnasium = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    for t in range(-2, steps):
        actions = rng.uniform(-1, 1, (episodes, maze.spec(name).action_size)).astype(np.float32)
        states = maze._physics.states.copy()
        seconds = timed(partial(maze.step, actions, rows))
        if t < 0:  # the first steps compile
            continue
        ours += seconds
        if t % COMPARE_EVERY == 0:
            shared += seconds
            slow += timed(partial(bare, maze, data, states, actions))
            if env:
                gymnasium += timed(lambda few=actions[:GYMNASIUM_EPISODES]: [env.step(action) for action in few])
    gymnasium *= episodes / GYMNASIUM_EPISODES
    return (
        f"{name:7} {episodes} x {steps} steps: {ours[0]:5.1f} s, {ours[1]:5.1f} s of processor time. One by one takes: "
        f"bare mj_step {ratio(slow, shared)}, gymnasium-robotics {ratio(gymnasium, shared)}"
    )


def ratio(slow: np.ndarray, ours: np.ndarray) -> str:
    """Time of the slow way in times of the fast one."""
    return "{:.2f}x ({:.2f}x processor time)".format(*slow / ours)


def gymnasium_env(env_id: str):  # noqa: ANN201
    """The environment of that name, without wrappers; None for no name."""
    if not env_id:
        return None
    from gymnasium_robotics.envs.maze import ant_maze_v4, maps, point_maze

    family = point_maze.PointMazeEnv if env_id.startswith("Point") else ant_maze_v4.AntMazeEnv
    env = family(maze_map=maps.MEDIUM_MAZE)
    env.reset(seed=0)
    return env


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    episodes = parser.parse_args().episodes
    for name in BODIES:
        print(measure(name, episodes), flush=True)


if __name__ == "__main__":
    main()
