"""A body in a maze: tasks, starts, success."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, NonNegativeInt, PositiveInt
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.maze.layout import LAYOUTS, Frame
from plp_lightning.envs.maze.walker_model import Box
from plp_lightning.envs.tasks import Tasks
from plp_lightning.envs.views import FloorPlan

if TYPE_CHECKING:
    from mujoco import MjData

    from plp_lightning.envs.maze.physics import MazePhysics
    from plp_lightning.envs.rendering.studio import Studio

LayoutName = Literal["umaze", "medium"]
FrameName = Literal["d4rl", "gymnasium"]


class Maze(Simulator):
    """A body in a maze whose tasks are pairs of a start zone and a goal cell; goals are never observed."""

    needs = ("mujoco", "gymnasium_robotics")

    scale: ClassVar[float]  # side of a cell, m
    frame_skip: ClassVar[int]  # physics steps of 10 ms in one control step
    horizons: ClassVar[dict[str, int]]  # default horizon of each layout
    _wall_height: ClassVar[float]  # m
    _forward: ClassVar[bool]  # True if Gymnasium-Robotics computes forces before each control step
    _body: str
    _action_size: int

    def __init__(
        self,
        layout: LayoutName,
        frame: FrameName = "d4rl",
        radius: NonNegativeFloat = 0.5,
        jitter: NonNegativeFloat = 0.25,
        horizon: PositiveInt | None = None,
        threads: NonNegativeInt = 0,
    ) -> None:
        if layout not in LAYOUTS:
            raise ConfigError(f"unknown maze layout {layout!r}; expected one of: {', '.join(LAYOUTS)}")
        self.layout = LAYOUTS[layout]
        self.frame = Frame.gymnasium(self.layout.shape, self.scale) if frame == "gymnasium" else self._d4rl_frame()
        self.horizon, self.threads = horizon or self.horizons[layout], threads
        self.success_radius, self._jitter = radius * self.scale, jitter
        self._description = f"MuJoCo {self._body} in maze {layout}, frame {frame}"

    @property
    def tasks(self) -> Tasks:
        """The maze's: ``s<zone>_g_<row>_<column>``, and ``detour_<row>_<column>`` in medium; targets are goals."""
        return self.layout.tasks

    def spec(self, name: str) -> DomainSpec:
        env = self._description + self._departures("radius", "jitter")
        return DomainSpec(name, self._keys(), self._action_size, 100 / self.frame_skip, env)

    def _departures(self, *names: str) -> str:
        """The named arguments that are not at their defaults, as the end of a spec's ``env``: ``, radius 0.3``.

        Of those that are nothing is said, so that files are known which are older than an argument.
        """
        defaults = inspect.signature(type(self)).parameters
        given = {name: self.arguments[name] for name in names if name in self.arguments}
        return "".join(f", {name} {value}" for name, value in given.items() if value != defaults[name].default)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        chosen = [self.layout.task(name) for name in tasks]
        starts = np.array([self._start(self.layout.starts(t), s) for t, s in zip(chosen, seeds, strict=True)])
        self._goals = self.frame.centres(np.array([task.goal for task in chosen]).reshape(-1, 2))
        self._pending = np.zeros((len(chosen), *self.layout.shape), dtype=bool)
        for episode, task in enumerate(chosen):
            for row, column in self.layout.via(task):
                self._pending[episode, row, column] = True
        everyone, physics = np.arange(len(chosen)), self._physics
        physics.begin(len(chosen))
        physics.states[:, physics.qpos][:, :2] = self.frame.centres(starts.reshape(-1, 2))
        physics.hold(everyone, np.zeros((len(chosen), self._action_size)), substeps=0, forward=True)
        self._visit(everyone)
        return self._observe(everyone)

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        controls = self.actions_in_maze(np.clip(actions.astype(np.float64), -1, 1))
        self._before_step(episodes)
        valid = self._physics.hold(episodes, controls, self.frame_skip, self._forward)
        self._visit(episodes)
        return Step(self._observe(episodes), valid & self._succeeded(episodes), ~valid)

    def states_in_maze(self, states: np.ndarray) -> np.ndarray:
        """States ``(n, O)`` that this domain shows, as the physics has them."""
        return states

    def states_of_domain(self, states: np.ndarray) -> np.ndarray:
        """States ``(n, O)`` of the physics as this domain shows them; inverse of :meth:`states_in_maze`."""
        return states

    def actions_in_maze(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)`` of this domain as the physics takes them."""
        return actions

    def actions_of_domain(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)`` of the physics as this domain takes them; inverse of :meth:`actions_in_maze`."""
        return actions

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Fractional row and column ``(n, 2)`` of the maze that observed states ``(n, O)`` are at."""
        return self.frame.cells(self.states_in_maze(state)[:, :2])

    def floor_plan(self) -> FloorPlan:
        """Walls ``(W, 2)`` in rows and columns, so that the same maze looks the same for all bodies."""
        goals = {name: (float(task.goal[0]), float(task.goal[1])) for name, task in self.layout.by_name.items()}
        return FloorPlan(np.array(self.layout.walls, dtype=float), 1.0, goals, self.success_radius / self.scale)

    def within(self, radius: float) -> Maze:
        """The same episodes, solved within another ``radius``, m; both step the same physics, one after the other."""
        closer = copy(self)
        closer.success_radius = radius
        return closer

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` of the whole maze from above, with the goal on its floor."""

        def mark_goal(data: MjData, episode: int) -> None:
            data.mocap_pos[0, :2] = self._goals[episode]

        return self._studio.pictures(self._physics, episodes, size, mark_goal)

    @abstractmethod
    def _keys(self) -> tuple[ObservationKey, ...]: ...

    @abstractmethod
    def _mjcf(self, walls: Sequence[Box]) -> str: ...

    @abstractmethod
    def _d4rl_frame(self) -> Frame: ...

    @cached_property
    def _physics(self) -> MazePhysics:
        from plp_lightning.envs.maze.physics import MazePhysics  # half a second that listing tasks need not pay

        return MazePhysics(self._mjcf(self._walls), self.threads)

    @cached_property
    def _studio(self) -> Studio:
        from plp_lightning.envs.maze.pictures import maze_studio

        return maze_studio(self._mjcf(self._walls), self.frame, self.layout.shape, self.success_radius)

    @property
    def _walls(self) -> list[Box]:
        centres = self.frame.centres(np.array(self.layout.walls)).tolist()
        return [Box(x, y, self.scale / 2, self._wall_height / 2) for x, y in centres]

    def _start(self, cells: Sequence[tuple[int, int]], seed: int) -> np.ndarray:
        rng = start_generator(seed)
        place: np.ndarray = np.array(cells[rng.integers(len(cells))]) + rng.uniform(-self._jitter, self._jitter, 2)
        return place

    def _before_step(self, rows: np.ndarray) -> None:
        """Change the physical states of rows ``(n,)`` before a control step."""

    def _observe(self, rows: np.ndarray) -> Observation[np.ndarray]:
        physical = self._physics.states[rows, self._physics.physical]
        return Observation(self.states_of_domain(physical).astype(np.float32))

    def _positions(self, rows: np.ndarray) -> np.ndarray:
        return self._physics.states[rows, self._physics.qpos][:, :2]

    def _visit(self, episodes: np.ndarray) -> None:
        rows, columns = self.layout.nearest(self.frame.cells(self._positions(episodes))).T
        self._pending[episodes, rows, columns] = False

    def _succeeded(self, episodes: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(self._positions(episodes) - self._goals[episodes], axis=1)
        succeeded: np.ndarray = (distance <= self.success_radius) & ~self._pending[episodes].any(axis=(1, 2))
        return succeeded
