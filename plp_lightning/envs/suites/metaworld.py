"""Any of Meta-World's tasks (https://github.com/Farama-Foundation/Metaworld), by name, from any of its cameras."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from datamodules.settings import NonNegativeInt, PositiveInt
from datamodules.types import DomainSpec, ObservationKey
from plp_lightning.envs.suites.simulator import Suite, pick_keys
from plp_lightning.envs.suites.variant import choose

if TYPE_CHECKING:
    from plp_lightning.envs.suites.share import WorldFactory

OWN = (ObservationKey("hand_pos", (3,), unit="m"), ObservationKey("gripper", (1,)))
OBJECTS = (
    ObservationKey("object_pos", (3,), unit="m"),
    ObservationKey("object_quat", (4,)),
    ObservationKey("object2_pos", (3,), unit="m"),
    ObservationKey("object2_quat", (4,)),
)
GOAL = ObservationKey("goal_pos", (3,), unit="m")
LAST = tuple(ObservationKey(f"last_{key.name}", key.shape, unit=key.unit) for key in (*OWN, *OBJECTS))
OFFERED = (*OWN, *OBJECTS, *LAST, GOAL)
"""All that Meta-World shows, in its order: 39 numbers."""
ABOUT_OBJECTS = tuple(key.name for key in OFFERED if "object" in key.name or key is GOAL)
VIEW = "corner2"  # the camera of films, where observations have none
SCENE = "sawyer_reach_v3.xml"  # any of them: all have the same cameras


class MetaWorld(Suite):
    """Any of Meta-World's 50 tasks, by name, with a Sawyer's hand that moves along x, y and z, and its gripper.

    The action moves the point that the hand follows by up to 1 cm along x, y and z; its fourth number opens (negative)
    or closes (positive) the gripper. Control runs at 80 Hz. Success is the library's own. Images show neither goals nor
    what marks handles; a goal is seen by the key ``goal_pos``.

    Args:
        tasks: Names of tasks, such as ``door-open-v3``, or with the part of its range in which an episode begins, such
            as ``door-open-v3_x0y1``.
        cameras: The library's, by name: ``corner2``, ``topview``, …; those that are upside down are put right.
        state: Keys that the policy sees: ``hand_pos``, ``gripper``, ``object_pos``, ``object_quat``, ``object2_pos``,
            ``object2_quat``, of this step and, with ``last_`` before the name, of the last one, and ``goal_pos``.
        objects: Without ``state``: show the keys of objects and the goal too.
        regions: Parts into which the range of the first object's place is cut along x and along y.
        image_size: Height and width of the images, pixels.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Processes that step; 0 means one for each core, at most 16 or ``PLP_PROCESSES``.

    Raises:
        ConfigError: If there is no such task or part of its range, no such key, no such camera, or no such image.
    """

    needs = ("mujoco", "numba", "metaworld")

    def __init__(
        self,
        tasks: list[str],
        cameras: list[str] | None = None,
        state: list[str] | None = None,
        objects: bool = True,
        regions: PositiveInt = 2,
        image_size: int = 64,
        horizon: PositiveInt = 500,
        threads: NonNegativeInt = 0,
    ) -> None:
        self._remember("Meta-World", tasks, cameras or (), image_size, regions)
        self._keys = pick_keys(OFFERED, state, () if objects else ABOUT_OBJECTS, "Meta-World")
        self.horizon, self.threads = horizon, threads

    def spec(self, name: str) -> DomainSpec:
        """The keys of the state, images ``(H, W, 3)`` by camera, and actions ``(4,)``."""
        env = ", ".join(["Meta-World", *self.cameras, *self._regions_told()])
        return DomainSpec(name, (*self._images, *self._keys), action_size=4, control_hz=80.0, env=env)

    def scripted(self, episodes: np.ndarray) -> np.ndarray:
        """Actions ``(n, 4)`` of the library's scripted policies in the episodes ``(n,)`` as they stand."""
        return self._pool.rows("demonstrate", episodes)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Position of the hand in the world, ``(N, 3)``, m."""
        return state[:, self.spec("").columns(["hand_pos"])]

    @cached_property
    def _images(self) -> tuple[ObservationKey, ...]:
        """Keys of the images; all names are looked up in the library."""
        from plp_lightning.envs.rendering.backend import choose_backend

        if self.cameras:
            choose_backend()  # before MuJoCo is imported, which asks for it then
        from plp_lightning.envs.suites.metaworld_world import NAMES
        from plp_lightning.envs.tabletop.model import read_scene

        for variant in self.variants:
            choose("task", variant.name, NAMES, "Meta-World")
        return self._image_keys([camera.name for camera in read_scene(SCENE).cameras])

    def _factory(self) -> WorldFactory:
        from plp_lightning.envs.suites.metaworld_world import MetaWorldFactory

        view, origin = (*self.cameras, VIEW)[0], " ".join(("Meta-World", *self.cameras))
        columns = _columns(self._keys)
        return MetaWorldFactory(origin, self.regions, self.cameras, view, self.image_size, columns)


def _columns(keys: Sequence[ObservationKey]) -> tuple[int, ...]:
    """Columns of the library's observation ``(39,)`` that hold the keys."""
    return tuple(DomainSpec("", OFFERED, 4, 80.0).columns([key.name for key in keys]))
