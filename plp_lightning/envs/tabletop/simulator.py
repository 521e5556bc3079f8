"""V2V: one task seen from two sides. A Sawyer reaches for a ball, or opens and closes a window, by what it sees.

The scenes and their physics are Meta-World's (https://github.com/Farama-Foundation/Metaworld); a domain is a
viewpoint. Images show what is there, and nothing that marks the goal; the state is the hand's own.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeInt, PositiveInt
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.tabletop.layout import Layout
from plp_lightning.envs.tasks import Tasks

if TYPE_CHECKING:
    from plp_lightning.envs.rendering.studio import Studio
    from plp_lightning.envs.tabletop.model import TabletopModel
    from plp_lightning.envs.tabletop.physics import TabletopPhysics

View = Literal["front_left", "front_right", "front", "rear"]

VIEWS: dict[View, tuple[float, float, float]] = {
    "front_left": (235.0, -35.0, 1.1),
    "front_right": (305.0, -45.0, 1.1),
    "front": (270.0, -40.0, 1.15),
    "rear": (125.0, -30.0, 1.15),
}
"""Azimuth and elevation, degrees, and distance, m, of the camera."""
RADIUS = 0.05  # distance that counts as there, Meta-World's, m
SLOTS = np.array([[-0.15, 0.8, 0.15], [0.0, 0.8, 0.15], [0.15, 0.8, 0.15]])  # places of the balls, m
REACH_HAND = np.array([[-0.15, 0.5, 0.1], [0.15, 0.65, 0.3]])  # lowest and highest start of the hand in Reach, m
PUCK = np.array([0.0, 0.0, 100.0])  # Meta-World's puck is of no use here; it falls from so high that it never arrives
WINDOW_HAND = np.array([[-0.1, 0.4, 0.15], [0.1, 0.5, 0.25]])
WINDOW_AREA = np.array([[-0.2, 0.65], [0.2, 0.9]])  # least and greatest x and y of the window's place, m
WINDOW_Z = 0.16
SLIDE = 0.2  # way that the window opens, m
AREAS = {f"close_x{i}y{j}": (i, j) for i in range(2) for j in range(2)}  # Window-Close, by quarter of the area


class Tabletop(Simulator):
    """A scene on the table: hand, camera, stepping.

    The action moves the point that the hand follows by up to 1 cm along x, y and z; its fourth number opens (negative)
    or closes (positive) the gripper. Control runs at 80 Hz.

    Args:
        view: From where the camera looks.
        image_size: Height and width of the images, pixels.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Threads that step and draw; 0 means one for each core.

    Raises:
        ConfigError: If there is no such view, or no image of that size.
    """

    needs = ("mujoco", "metaworld")

    def __init__(
        self, view: View, image_size: int = 64, horizon: PositiveInt = 150, threads: NonNegativeInt = 0
    ) -> None:
        if view not in get_args(View):
            raise ConfigError(f"view is {view!r}; expected one of: {', '.join(get_args(View))}")
        if not 8 <= image_size <= 512:
            raise ConfigError(f"image_size is {image_size}; expected 8 to 512 pixels")
        self.view, self.image_size, self.horizon, self.threads = view, image_size, horizon, threads

    def spec(self, name: str) -> DomainSpec:
        """An image ``(H, W, 3)``, and place ``(3,)`` of the hand and opening ``(1,)`` of the gripper, new and old."""
        keys = (
            ObservationKey("image", (self.image_size, self.image_size, 3), kind="image"),
            ObservationKey("hand_pos", (3,), unit="m"),
            ObservationKey("gripper", (1,)),
            ObservationKey("last_hand_pos", (3,), unit="m"),
            ObservationKey("last_gripper", (1,)),
        )
        env = f"Meta-World {self.tasks.family}, {self.view}"
        return DomainSpec(name, keys, action_size=4, control_hz=80.0, env=env)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Position of the hand in the world, ``(N, 3)``, m."""
        return state[:, self.spec("").columns(["hand_pos"])]

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.tasks.check(tasks)
        layouts = [self._layout(task, self._stream(seed)) for task, seed in zip(tasks, seeds, strict=True)]
        first = self._physics.reset(layouts)
        self._begin(tasks, layouts)
        return first

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        observation, invalid = self._physics.step(actions, episodes)
        return Step(observation, self._solved(episodes) & ~invalid, invalid)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` from where the camera is."""
        return self._studio.pictures(self._physics, episodes, size)

    @abstractmethod
    def aims(self, episodes: np.ndarray) -> np.ndarray:
        """Place ``(n, 3)`` of the ball or handle in each of the episodes ``(n,)``, m: for experts, not policies."""

    @abstractmethod
    def _layout(self, task: str, stream: np.random.Generator) -> Layout: ...

    @abstractmethod
    def _scene(self) -> TabletopModel: ...

    @abstractmethod
    def _begin(self, tasks: Sequence[str], layouts: Sequence[Layout]) -> None: ...

    @abstractmethod
    def _solved(self, rows: np.ndarray) -> np.ndarray: ...

    @cached_property
    def _physics(self) -> TabletopPhysics:
        from plp_lightning.envs.rendering.backend import choose_backend

        choose_backend()  # before MuJoCo is imported, which asks for it then
        from plp_lightning.envs.rendering.camera import Viewpoint
        from plp_lightning.envs.tabletop.physics import TabletopPhysics

        return TabletopPhysics(self._scene(), Viewpoint(*VIEWS[self.view]), self.image_size, self.threads)

    @cached_property
    def _studio(self) -> Studio:
        from plp_lightning.envs.rendering.studio import Studio

        return Studio(copy(self._physics.model), self._physics.viewpoint)

    def _stream(self, seed: int) -> np.random.Generator:
        # The view joins the seed, so that equal seeds do not align the domains' episodes.
        return start_generator(seed, f"{self.tasks.family} {self.view}")


class Reach(Tabletop):
    """Touch the ball of one colour: three balls in random order, and the task names the colour.

    The first ball that the fingertips come near to counts: visiting them in turn solves nothing. Pictures and
    states of an episode do not depend on its task.
    """

    tasks = Tasks("V2V-Reach", ("red", "green", "blue"))

    def arrangement(self, task: str, seed: int) -> str:
        """The balls in the order of their places, ``red green blue`` for instance; the task does not matter."""
        order = _draw_reach(self._stream(seed))[1]
        return " ".join(self.tasks.names[ball] for ball in np.argsort(order))

    def aims(self, episodes: np.ndarray) -> np.ndarray:
        aims: np.ndarray = self._balls[episodes, self._goal[episodes]]
        return aims

    def _layout(self, task: str, stream: np.random.Generator) -> Layout:
        hand, order = _draw_reach(stream)
        return Layout(hand, SLOTS[order], PUCK)

    def _scene(self) -> TabletopModel:
        from plp_lightning.envs.tabletop.model import reach_model

        return reach_model(self.image_size)

    def _begin(self, tasks: Sequence[str], layouts: Sequence[Layout]) -> None:
        self._balls = np.array([layout.furniture for layout in layouts]).reshape(-1, 3, 3)
        self._goal = np.array([self.tasks.names.index(task) for task in tasks], dtype=np.int64)
        self._touched = np.full(len(tasks), -1)

    def _solved(self, rows: np.ndarray) -> np.ndarray:
        fingers = self._physics.sites[rows].mean(axis=1, keepdims=True)
        near = np.linalg.norm(fingers - self._balls[rows], axis=-1) <= RADIUS
        first = (self._touched[rows] < 0) & near.any(axis=1)
        self._touched[rows[first]] = near[first].argmax(axis=1)
        solved: np.ndarray = near[np.arange(len(rows)), self._goal[rows]] & (self._touched[rows] == self._goal[rows])
        return solved


class Window(Tabletop):
    """Close a window that stands in a known quarter of the table, or open one that stands anywhere on it."""

    tasks = Tasks("V2V-Open", (*AREAS, "open"))

    def aims(self, episodes: np.ndarray) -> np.ndarray:
        handle: np.ndarray = self._physics.sites[episodes, self._handle[episodes]]
        return handle

    def _layout(self, task: str, stream: np.random.Generator) -> Layout:
        hand, share = stream.uniform(*WINDOW_HAND), stream.uniform(size=2)
        if task != "open":
            share = (np.array(AREAS[task]) + share) / 2
        place = WINDOW_AREA[0] + share * (WINDOW_AREA[1] - WINDOW_AREA[0])
        return Layout(hand, np.array([[*place, WINDOW_Z]]), np.array([0.0 if task == "open" else SLIDE]))

    def _scene(self) -> TabletopModel:
        from plp_lightning.envs.tabletop.model import window_model

        return window_model(self.image_size)

    def _begin(self, tasks: Sequence[str], layouts: Sequence[Layout]) -> None:
        opening = np.array([task == "open" for task in tasks], dtype=np.bool_)
        self._handle = np.where(opening, 2, 3)  # behind the two fingertips: for opening, for closing
        self._end = np.array([layout.furniture[0, 0] for layout in layouts]) + SLIDE * opening

    def _solved(self, rows: np.ndarray) -> np.ndarray:
        solved: np.ndarray = np.abs(self.aims(rows)[:, 0] - self._end[rows]) <= RADIUS
        return solved


def _draw_reach(stream: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return stream.uniform(*REACH_HAND), stream.permutation(len(SLOTS))
