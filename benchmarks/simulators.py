"""100 episodes of point and ant, of Lift and of Reach, beside the environments that they come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from plp_lightning.envs.rendering.backend import choose_backend

choose_backend()  # Meta-World's pictures ask for it when MuJoCo is imported

import mujoco  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.episodes import Together, compared, hold  # noqa: E402
from benchmarks.measuring import Options, Row  # noqa: E402
from plp_lightning.envs.lift.building import robosuite_env  # noqa: E402
from plp_lightning.envs.lift.osc import SUBSTEPS as LIFT_SUBSTEPS  # noqa: E402
from plp_lightning.envs.lift.robots import Robot  # noqa: E402
from plp_lightning.envs.lift.simulator import Lift  # noqa: E402
from plp_lightning.envs.maze.base import Maze  # noqa: E402
from plp_lightning.envs.maze.simulator import PointMaze, WalkerMaze  # noqa: E402
from plp_lightning.envs.tabletop.physics import SUBSTEPS as TABLETOP_SUBSTEPS  # noqa: E402
from plp_lightning.envs.tabletop.simulator import Reach  # noqa: E402


def maze_env(walker: bool) -> Any:
    """Gymnasium-Robotics' environment, without wrappers."""
    from gymnasium_robotics.envs.maze import ant_maze_v4, maps, point_maze

    env = (ant_maze_v4.AntMazeEnv if walker else point_maze.PointMazeEnv)(maze_map=maps.MEDIUM_MAZE)
    env.reset(seed=0)
    return env


def maze(options: Options, body: str) -> Iterator[Row]:
    """Point or ant, in the medium maze."""
    bodies: dict[str, Callable[[], Maze]] = {
        "point": lambda: PointMaze("medium", frame="gymnasium"),
        "ant": lambda: WalkerMaze("medium", frame="gymnasium"),
    }
    simulator, env = bodies[body](), maze_env(body == "ant")
    ours, physics = Together(simulator), simulator._physics
    data = mujoco.MjData(physics.model)
    bare = partial(hold, physics, data, simulator.frame_skip, forward=body == "point")  # whose speed it limits
    yield from compared(body, ours, bare, env.step, options, 200)


def lift(options: Options) -> Iterator[Row]:
    """R2R-Lift of both robots."""
    robots: tuple[Robot, ...] = ("Sawyer", "UR5e")
    for robot in robots[: options.pick(2, 1)]:
        simulator, env = Lift(robot), robosuite_env(robot, joint_noise=0.05)
        env.reset()
        ours, physics = Together(simulator), simulator._physics
        bare = partial(hold, physics, mujoco.MjData(physics.model), LIFT_SUBSTEPS)
        yield from compared(f"Lift, {robot}", ours, bare, env.step, options, 20)


def reach_env() -> tuple[Any, mujoco.Renderer]:
    """Meta-World's environment, and a renderer of its scene."""
    import metaworld

    env = metaworld.env_dict.ALL_V3_ENVIRONMENTS["reach-v3"]()
    env.set_task(metaworld.ML1("reach-v3").train_tasks[0])
    env.reset()
    return env, mujoco.Renderer(env.model, 64, 64)


def reach(options: Options) -> Iterator[Row]:
    """V2V-Reach with images of 64 × 64; bare physics is compared with steps that nobody draws."""
    simulator, (env, renderer) = Reach("front_left"), reach_env()
    ours, physics = Together(simulator), simulator._physics

    def one(action: np.ndarray) -> None:
        env.curr_path_length = 0  # or it would end
        env.step(action)
        renderer.update_scene(env.data)
        renderer.render()

    def blind() -> None:
        look, physics._look = physics._look, lambda room, row: None  # type: ignore[method-assign]
        ours.step_alone()
        physics._look = look  # type: ignore[method-assign]

    bare = partial(hold, physics, mujoco.MjData(physics.model), TABLETOP_SUBSTEPS)
    yield from compared("Reach", ours, bare, one, options, 20, blind, share=50)
