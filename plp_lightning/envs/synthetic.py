"""Domains with a known answer: one point in the plane, seen and moved through a different linear map in each.

All domains share the latent state p in the plane and the latent action u, a velocity. A domain shows ``A p + b`` for
its own injective A and takes ``R u`` for its own rotation R, so the maps that a transfer has to find exist, are linear
and are known. They make every part of the framework run in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datamodules.errors import UserError
from datamodules.settings import NonNegativeFloat, NonNegativeInt, PositiveInt
from datamodules.streams import EpisodeStream, episode_generator, start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Expert, Simulator, Step
from plp_lightning.envs.rendering.plane import Discs, draw_plane
from plp_lightning.envs.tasks import Tasks

GOALS = 8  # goals on the unit circle; a task is one of them
RADIUS = 0.15  # an episode succeeds within this distance of its goal
STRIDE = 0.1  # distance that a full action moves the point in one control step
REACH, POINT = 1.3, 0.05  # edge of what is drawn, and radius with which the point is
BLACK, GREY, RED, GREEN, BLUE = (0, 0, 0), (215, 215, 215), (213, 94, 0), (0, 158, 115), (0, 114, 178)


class LinearPoint(Simulator):
    """A point in the plane behind a linear map.

    Args:
        map_seed: Chooses the maps of this domain.
        state_size: O, at least 2.
        horizon: Control steps of an episode.
    """

    tasks = Tasks("LinearPoint", tuple(f"goal_{i}" for i in range(GOALS)))
    threads = 1

    def __init__(self, map_seed: NonNegativeInt, state_size: PositiveInt = 4, horizon: PositiveInt = 40) -> None:
        self.map_seed, self.state_size, self.horizon = map_seed, state_size, horizon
        rng = np.random.default_rng(map_seed)
        self.lift = np.linalg.qr(rng.normal(size=(state_size, 2)))[0]
        self.shift = rng.normal(size=state_size)
        self.rotation = _rotation(rng.uniform(0, 2 * np.pi))

    def spec(self, name: str) -> DomainSpec:
        keys = (ObservationKey("position", (self.state_size,)),)
        env = f"LinearPoint({self.map_seed})"
        return DomainSpec(name, keys, 2, control_hz=10.0, env=env)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """The point in the plane, ``(N, 2)``."""
        plane: np.ndarray = (state - self.shift) @ self.lift
        return plane

    def goals_of(self, tasks: Sequence[str], seeds: Sequence[int]) -> np.ndarray:
        """Goals ``(E, 2)`` of episodes in the plane."""
        return np.array([self.goal(task) for task in tasks])

    def goal(self, task: str) -> np.ndarray:
        """The task's goal ``(2,)`` in the plane."""
        angle = 2 * np.pi * self.tasks.names.index(task) / GOALS
        return np.array([np.cos(angle), np.sin(angle)])

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.goals = self.goals_of(tasks, seeds)
        self.point = np.array([start_generator(seed).uniform(-0.3, 0.3, 2) for seed in seeds])
        return self._observe(np.arange(len(tasks)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        invalid = ~np.isfinite(actions).all(axis=1)
        clean = np.clip(np.nan_to_num(actions), -1, 1)
        self.point[episodes] += STRIDE * clean @ self.rotation
        distance = np.linalg.norm(self.point[episodes] - self.goals[episodes], axis=1)
        return Step(self._observe(episodes), (distance < RADIUS) & ~invalid, invalid)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` of the plane: the point, and the goals."""
        return draw_plane([*self._goals_seen(episodes), Discs(self.point[episodes], POINT, BLACK)], REACH, size)

    def _goals_seen(self, episodes: np.ndarray) -> list[Discs]:
        """All goals, and the episode's own on top."""
        others = [np.tile(self.goal(name), (len(episodes), 1)) for name in self.tasks.names]
        return [*(Discs(places, RADIUS, GREY) for places in others), Discs(self.goals[episodes], RADIUS, GREEN)]

    def _observe(self, episodes: np.ndarray) -> Observation[np.ndarray]:
        return Observation((self.point[episodes] @ self.lift.T + self.shift).astype(np.float32))


class SeenPoint(LinearPoint):
    """A point in the plane whose goals a camera shows: three spots, red, green and blue; a task is a colour.

    The spots stand at three places of the unit circle in one of six orders, which an episode's seed chooses, so
    that without the image the goal can only be guessed. Each domain's camera looks from an angle of its own.

    Args:
        map_seed: Chooses the maps of this domain, the camera's angle among them.
        state_size: O, at least 2.
        horizon: Control steps of an episode.
        image_size: Height and width of an image, pixels.
        wrist_size: Height and width of the images of a second camera, ``wrist``, which moves with the point; 0 leaves
            it away.
    """

    tasks = Tasks("SeenPoint", ("red", "green", "blue"))

    def __init__(
        self,
        map_seed: NonNegativeInt,
        state_size: PositiveInt = 4,
        horizon: PositiveInt = 40,
        image_size: PositiveInt = 16,
        wrist_size: NonNegativeInt = 0,
    ) -> None:
        super().__init__(map_seed, state_size, horizon)
        self.sizes = {"camera": image_size} | ({"wrist": wrist_size} if wrist_size else {})
        self.view = _rotation(np.random.default_rng([map_seed, 1]).uniform(0, 2 * np.pi))

    def spec(self, name: str) -> DomainSpec:
        cameras = (ObservationKey(name, (size, size, 3), kind="image") for name, size in self.sizes.items())
        keys = (*cameras, ObservationKey("position", (self.state_size,)))
        env = f"SeenPoint({self.map_seed})"
        return DomainSpec(name, keys, 2, control_hz=10.0, env=env)

    def spots(self, seeds: Sequence[int]) -> np.ndarray:
        """Places of the three colours ``(E, 3, 2)`` in the plane."""
        angles = 2 * np.pi * np.arange(3) / 3
        places = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.array([places[episode_generator(seed, EpisodeStream.SPOTS).permutation(3)] for seed in seeds])

    def goals_of(self, tasks: Sequence[str], seeds: Sequence[int]) -> np.ndarray:
        return self.spots(seeds)[np.arange(len(tasks)), [self.tasks.names.index(task) for task in tasks]]

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.colours = self.spots(seeds)
        return super().reset(tasks, seeds)

    def _observe(self, episodes: np.ndarray) -> Observation[np.ndarray]:
        state = super()._observe(episodes).state
        centres = {"camera": np.zeros(2), "wrist": self.point[episodes][:, None]}
        return Observation(state, {name: self._image(episodes, centres[name], n) for name, n in self.sizes.items()})

    def _goals_seen(self, episodes: np.ndarray) -> list[Discs]:
        return [Discs(self.colours[episodes, i], RADIUS, colour) for i, colour in enumerate((RED, GREEN, BLUE))]

    def _image(self, episodes: np.ndarray, centre: np.ndarray, size: int) -> np.ndarray:
        point = self.point[episodes][:, None]
        lights = self._light(self.colours[episodes] - centre, size) + self._light(point - centre, size)
        image: np.ndarray = np.minimum(lights * 255, 255).astype(np.uint8)
        return image

    def _light(self, places: np.ndarray, size: int) -> np.ndarray:
        """Spots of light at places ``(n, C, 2)``, one a channel, as ``(n, H, W, C)``; C = 1 is white."""
        seen = places @ self.view.T
        pixels = np.linspace(-REACH, REACH, size)
        rows, columns = (np.exp(-((pixels[:, None] - seen[:, None, :, i]) ** 2) / 0.05) for i in range(2))
        light: np.ndarray = rows[:, :, None] * columns[:, None]
        return light


class LinearPointExpert(Expert):
    """Goes straight to the goal, slower when it is near; it inverts the domain's maps.

    Args:
        gain: Action for each unit of distance.
    """

    def __init__(self, gain: NonNegativeFloat = 2.0) -> None:
        self.gain = gain

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        if not isinstance(simulator, LinearPoint):
            raise UserError(f"LinearPointExpert demonstrates in LinearPoint only, not in {type(simulator).__name__}")
        self.simulator, self.goals = simulator, simulator.goals_of(tasks, seeds)

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        point = (observation.state - self.simulator.shift) @ self.simulator.lift
        velocity = self.gain * (self.goals[episodes] - point)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        actions: np.ndarray = (velocity / np.maximum(1, speed)) @ self.simulator.rotation.T
        return actions


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
