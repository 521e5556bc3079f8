"""robosuite's environments as worlds: its reset, its controllers, its sensors and its check.

Importing this module imports robosuite.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import mujoco
import numpy as np

from datamodules.errors import ConfigError
from plp_lightning.envs.lift.compiling import own_xml
from plp_lightning.envs.lift.state import Workspace
from plp_lightning.envs.suites.drives import drives
from plp_lightning.envs.suites.quiet import quiet
from plp_lightning.envs.suites.setup import OBJECT, Setup
from plp_lightning.envs.suites.torques import hold
from plp_lightning.envs.suites.variant import Variant, choose
from plp_lightning.envs.suites.world import World

with quiet():
    import robosuite
    from robosuite.controllers import load_composite_controller_config, load_part_controller_config
    from robosuite.models.robots.robot_model import REGISTERED_ROBOTS
    from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot
    from robosuite.utils import RandomizationError

TRIES = 50  # to place objects that don't touch


_SCREENLESS: Mapping[str, Any] = {
    "use_camera_obs": False,
    "has_offscreen_renderer": False,
    "renderer": "mujoco",
    "hard_reset": False,
    "ignore_done": True,
    "seed": 0,  # of what a model has once for all, such as the size of a block
}


def library_env(setup: Setup, name: str) -> Any:
    """The library's environment of that name.

    Raises:
        ConfigError: If a name is unknown, or the library makes nothing of these settings.
    """
    choose("task", name, sorted(robosuite.ALL_ENVIRONMENTS), "robosuite")
    robots = [choose("robot", robot, sorted(robosuite.ALL_ROBOTS), "robosuite") for robot in setup.robots]
    for robot in robots:
        _check_stands(robot)
    fixed = {"initialization_noise": {"type": "gaussian", "magnitude": setup.joint_noise}, **_SCREENLESS}
    try:
        with quiet():
            controllers = [_controller(robot, setup.controller) for robot in robots]
            words = {"robots": robots, "controller_configs": controllers, "control_freq": setup.control_hz}
            env = robosuite.make(name, **words, **fixed, **dict(setup.make))
    except ConfigError:
        raise
    except Exception as error:  # assertions, and whatever else its constructors meet
        told = f"robosuite makes no {name} with {', '.join(robots)}: {' '.join(str(error).split())[:200]}"
        raise ConfigError(f"{told}; choose other robots, another controller or other words to make it") from error
    if getattr(env, "single_object_mode", 0) == 1:
        told = f"robosuite's {name} is about another object in each episode, and shows other keys"
        raise ConfigError(f"{told}; expected the same in all: name tasks of one object each, as PickPlaceCan is")
    return env


def _check_stands(robot: str) -> None:
    """Refuse robots that move about: after a reset of the library's, what they did before is still felt."""
    standing = sorted(name for name, kind in ROBOT_CLASS_MAPPING.items() if kind is FixedBaseRobot)
    if robot not in standing:
        told = f"robosuite's {robot} moves about, and its resets leave something behind: no episode is the same twice"
        raise ConfigError(f"{told}; expected a robot that stands: choose {', '.join(standing)}")


def _controller(robot: str, name: str | None) -> dict[str, Any]:
    """The robot's own settings of a composite controller, with part controllers of that name in its arms."""
    own: dict[str, Any] = load_composite_controller_config(robot=robot)
    composite, parts = robosuite.ALL_COMPOSITE_CONTROLLERS, robosuite.ALL_PART_CONTROLLERS
    if name is None:
        return own
    if choose("controller", name, sorted({*composite, *parts}), "robosuite") in composite:
        made: dict[str, Any] = load_composite_controller_config(controller=name, robot=robot)
        return made
    body = own["body_parts"]
    for arm in REGISTERED_ROBOTS[robot].arms:
        if body.get(arm, {}).get("type") != name:
            body[arm] = {**load_part_controller_config(default_controller=name), "gripper": {"type": "GRIP"}}
    return own


class RobosuiteWorld(World):
    """An environment of robosuite.

    Args:
        setup: Its settings.
        name: The library's name of it.
        spread: Factor on the ranges in which it places objects.
        keys: Names of what is seen, in order.
        turned: Let objects be turned at random.
    """

    rearranges = True  # Wipe takes away what is wiped
    colliding = 0  # robosuite's group of geoms that collide; those to be seen are in another

    def __init__(
        self, setup: Setup, name: str, spread: float = 1.0, keys: Sequence[str] = (), turned: bool = True
    ) -> None:
        self.env = library_env(setup, name)
        self.keys, self.sim = keys, self.env.sim
        self.substeps = int(self.env.control_timestep / self.env.model_timestep)
        self.ranges = [(sampler, _spread(sampler, spread)) for sampler in _samplers(self.env)]
        for sampler, _ in self.ranges if not turned else ():
            sampler.rotation = 0.0
        grippers = [gripper for robot in self.env.robots for gripper in robot.gripper.values()]
        model, data = self.sim.model._model, self.sim.data._data
        self.work = Workspace.of(model, data)
        super().__init__(model, data, (self.env, *self.env.robots, *grippers))

    def begin(self, variant: Variant, stream: np.random.Generator) -> None:
        for axis, name in enumerate(("x_range", "y_range")):
            wide = [(sampler, ends[axis]) for sampler, ends in self.ranges if not np.isclose(*ends[axis])]
            for sampler, (low, high) in wide:
                setattr(sampler, name, variant.narrow(axis, low, high))
            if not wide:
                variant.narrow(axis, 0.0, 0.0)
        # Samplers hold the environment's generator too.
        self.env.rng.bit_generator.state = stream.bit_generator.state
        self._reset(variant)

    def _reset(self, variant: Variant) -> None:
        """Let the library place the objects, again where the first of them leave no room for the others."""
        for _ in range(TRIES):
            with quiet(), suppress(RandomizationError):
                self.env.reset()
                return
        told = f"the objects of task {variant.name} have no room in {variant.parts} x {variant.parts} regions"
        raise ConfigError(f"{told}; expected larger ones: set fewer regions or a larger spread")

    def act(self, action: np.ndarray) -> None:
        env, sim = self.env, self.sim
        env.timestep += 1
        sim.step1()
        env._pre_action(action, True)
        sim.step2()
        arms = drives(env)
        if arms is not None:
            hold(self.work, arms, self.substeps - 1)
        for _ in range(self.substeps - 1 if arms is None else 0):
            sim.step1()
            env._pre_action(action, False)
            sim.step2()
        env.cur_time += env.control_timestep
        if self.sane():
            env.reward(action)  # in which some environments note what was done

    def observe(self) -> np.ndarray:
        self.env.last_sensed = self.sensed()  # while what sensors read belongs to this episode
        return self.told(tuple(self.keys))

    def told(self, keys: tuple[str, ...]) -> np.ndarray:
        seen = self.env.last_sensed
        return np.concatenate([seen[key] for key in keys]) if keys else np.zeros(0)

    def sensed(self) -> dict[str, np.ndarray]:
        """All that the environment's sensors show, by name.

        Some are there for others alone, and are not shown. Where an object is from the hand comes, as the library has
        it, of the object's pose a step before; zeros at the start.
        """
        seen: dict[str, Any] = {**getattr(self.env, "last_sensed", {})}
        sensors = {name: found for name, found in self.env._observables.items() if found.modality != "image"}
        for name, observable in sensors.items():
            seen[name] = observable._sensor(seen)
        shown = {name: found for name, found in sensors.items() if found.is_enabled() and found.is_active()}
        about = [np.ravel(seen[name]) for name, found in shown.items() if found.modality == OBJECT]
        return {name: np.array(seen[name]).ravel() for name in shown} | (
            {OBJECT: np.concatenate(about)} if about else {}
        )

    def solved(self) -> bool:
        return bool(self.env._check_success())

    def scene(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_string(own_xml(self.env))


def _samplers(env: Any) -> Iterator[Any]:
    """Samplers of places that an environment has, those within others too."""
    left = [getattr(env, "placement_initializer", None)]
    while left:
        sampler = left.pop()
        left += [*getattr(sampler, "samplers", {}).values()]
        if hasattr(sampler, "x_range"):
            yield sampler


def _spread(sampler: Any, factor: float) -> tuple[tuple[float, float], ...]:
    """A sampler's ranges along x and y, made longer by a factor about their middles."""
    ends = [(min(ends), max(ends)) for ends in (sampler.x_range, sampler.y_range)]
    return tuple(
        ((low + high) / 2 - factor * (high - low) / 2, (low + high) / 2 + factor * (high - low) / 2)
        if factor != 1.0
        else (low, high)
        for low, high in ends
    )
