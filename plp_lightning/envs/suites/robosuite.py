"""Any task of robosuite (https://robosuite.ai), by name, with any of its robots and controllers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from datamodules.types import DomainSpec, ObservationKey
from plp_lightning.envs.suites.facts import Facts, described, facts
from plp_lightning.envs.suites.setup import OBJECT, Setup
from plp_lightning.envs.suites.simulator import Suite, pick_keys

if TYPE_CHECKING:
    from plp_lightning.envs.suites.share import WorldFactory

VIEW = "frontview"  # the camera of films, where observations have none


class Robosuite(Suite):
    """Any task of robosuite, by name, with any of its robots and controllers.

    Actions are the controller's, an arm's before its gripper's, and robot after robot. Success is the library's own.

    Args:
        tasks: Names of tasks, such as ``Stack``, or with the part of the table in which objects are placed, such as
            ``Stack_x0y1``.
        robot: The robot, such as ``Panda``; two with a ``+`` between them, where a task is for two.
        controller: ``OSC_POSE``, ``OSC_POSITION``, ``JOINT_POSITION``, …, or a composite one such as ``BASIC``; the
            robot's own if not given.
        state: Keys that the policy sees, as the library names them, such as ``robot0_eef_pos`` and ``cube_pos``;
            ``object`` is all of objects, as robomimic's files have it. If not given, all.
        objects: Without ``state``: show keys of objects too.
        cameras: The library's, by name: ``agentview``, ``robot0_eye_in_hand``, …
        regions: Parts into which the ranges of places are cut along x and along y.
        spread: Factor on the lengths of these ranges.
        turned: Turn objects at random, as the library does.
        joint_noise: Standard deviation of the initial joint angles, rad.
        control_hz: Control steps in a second.
        make: Further arguments of the library's environments, such as ``{table_friction: [1.0, 0.005, 0.0001]}``.
        image_size: Height and width of the images, pixels.
        horizon: Control steps after which an unsolved episode counts as failed.
        threads: Processes that step; 0 means one for each core, at most 16 or ``PLP_PROCESSES``.

    Raises:
        ConfigError: If robosuite knows no such name, or makes nothing of these settings.
    """

    needs = ("mujoco", "numba", "robosuite")

    def __init__(
        self,
        tasks: list[str],
        robot: str,
        controller: str | None = None,
        state: list[str] | None = None,
        objects: bool = True,
        cameras: list[str] | None = None,
        regions: PositiveInt = 2,
        spread: PositiveFloat = 1.0,
        turned: bool = True,
        joint_noise: NonNegativeFloat = 0.02,
        control_hz: PositiveInt = 20,
        make: dict[str, Any] | None = None,
        image_size: int = 64,
        horizon: PositiveInt = 400,
        threads: NonNegativeInt = 0,
    ) -> None:
        self._remember("robosuite", tasks, cameras or (), image_size, regions)
        robots = tuple(name.strip() for name in robot.split("+"))
        self.setup = Setup(robots, controller, control_hz, joint_noise, tuple(sorted((make or {}).items())))
        self.state, self.objects, self.spread = state, objects, spread
        self.horizon, self.threads, self.turned = horizon, threads, turned

    def spec(self, name: str) -> DomainSpec:
        """The keys of the state, images ``(H, W, 3)`` by camera, and the controller's actions ``(A,)``."""
        keys = (*self._image_keys(self._facts.cameras), *self._state_keys)
        env = "robosuite " + ", ".join(filter(None, [" + ".join(self.setup.robots), *self._departures()]))
        return DomainSpec(name, keys, self._facts.action_size, float(self.setup.control_hz), env)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Position ``(N, 3)`` of the first robot's hand in the world, m."""
        return state[:, self.spec("").columns(["robot0_eef_pos"])]

    def told(self, episodes: np.ndarray, keys: Sequence[str]) -> np.ndarray:
        """All that the library shows under these keys in the episodes ``(n,)``, ``(n, O)``: for experts."""
        return self._pool.rows("told", episodes, tuple(keys))

    def _departures(self) -> list[str]:
        """Settings that change what is seen or done, where they are not usual."""
        setup = self.setup
        told = [f"joint noise {setup.joint_noise} rad", *(f"{name} {value}" for name, value in setup.make)]
        told += [f"spread {self.spread:g}"] * (self.spread != 1.0) + self._regions_told()
        told += ["objects not turned"] * (not self.turned)
        return [setup.controller or "", *told, *self.cameras]

    @cached_property
    def _facts(self) -> Facts:
        names = dict.fromkeys(variant.name for variant in self.variants)
        try:
            return reduce(Facts.common, [facts(described(self.setup, name)) for name in names])
        except TypeError as error:
            raise ConfigError(f"Robosuite.make is {dict(self.setup.make)}; expected numbers, words, lists") from error

    @property
    def _state_keys(self) -> tuple[ObservationKey, ...]:
        found, about = self._facts, (OBJECT, *self._facts.about_objects)
        offered = [ObservationKey(name, (size,)) for name, size in found.sizes.items()]
        hidden = (OBJECT,) if self.objects else about
        return pick_keys(offered, self.state, hidden, f"robosuite's {', '.join(self.tasks.names)}")

    def _factory(self) -> WorldFactory:
        if self.cameras:
            from plp_lightning.envs.rendering.backend import choose_backend

            choose_backend()  # before MuJoCo is imported, which asks for it then
        from plp_lightning.envs.suites.robosuite_factory import RobosuiteFactory

        view, origin = (*self.cameras, VIEW)[0], " ".join(("robosuite", *self.setup.robots, *self.cameras))
        keys = tuple(key.name for key in self._state_keys)
        return RobosuiteFactory(
            origin, self.regions, self.cameras, view, self.image_size, self.setup, self.spread, self.turned, keys
        )
