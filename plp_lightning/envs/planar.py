"""Planar arms without physics: their joints move as fast as they are told, and their tips come to places on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from datamodules.errors import ConfigError
from datamodules.settings import PositiveFloat, PositiveInt
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs.base import Simulator, Step
from plp_lightning.envs.rendering.plane import Bars, Discs, draw_plane
from plp_lightning.envs.tasks import Tasks

COLUMNS, ROWS = (-0.35, 0.0, 0.35), (0.3, 0.525, 0.75)
PLACES = {f"x{i}y{j}": (x, y) for i, x in enumerate(COLUMNS) for j, y in enumerate(ROWS)}
"""Places by task, m; the arm's base is at (0, 0)."""
RADIUS = 0.05  # an episode succeeds within this distance of its place, m
HZ = 20.0
FOLDED, JITTER = (0.2, 2.4), 0.3  # first angle and all others together at the start, and how far each may be off, rad
CENTRE, REACH = np.array([0.0, 0.4]), 0.75  # middle of what is drawn, and the way to its edges, m
GREY, GREEN, BLUE, BLACK = (215, 215, 215), (0, 158, 115), (0, 114, 178), (0, 0, 0)


class PlanarArm(Simulator):
    """An arm in the plane that brings its tip to one of nine places.

    The state is ``joints (L), tip (2)``: each link's angle to the link before it, and where the last one ends. The
    action is a speed for each joint, which follows it at once, up to half a turn to either side. Control runs at 20 Hz.

    Args:
        links: Lengths of the L links from the base on, m.
        speed: Speed of a joint by a full action, rad/s.
        horizon: Control steps of an episode.

    Raises:
        ConfigError: If there are fewer than two links, or a place is out of their reach.
    """

    tasks = Tasks("PlanarArm", tuple(PLACES))
    threads = 1

    def __init__(self, links: list[PositiveFloat], speed: PositiveFloat = 1.5, horizon: PositiveInt = 80) -> None:
        self.links, self.speed, self.horizon = np.array(links), speed, horizon
        near, far = (find(float(np.hypot(*place)) for place in PLACES.values()) for find in (min, max))
        if len(links) < 2 or sum(links) < far or 2 * max(links) - sum(links) > near:
            told = f"expected two or more whose tip comes from {near:.2f} to {far:.2f} m from the base"
            raise ConfigError(f"PlanarArm.links is {links}; {told}: change their lengths")

    def spec(self, name: str) -> DomainSpec:
        keys = ObservationKey("joints", (len(self.links),), unit="rad"), ObservationKey("tip", (2,), unit="m")
        limits = (-self.speed,) * len(self.links), (self.speed,) * len(self.links)
        return DomainSpec(name, keys, len(self.links), HZ, f"PlanarArm {self.links.tolist()}", *limits)

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Place of the tip, ``(N, 2)``, m."""
        return state[:, -2:]

    def points(self, joints: np.ndarray) -> np.ndarray:
        """Ends of the links ``(n, L, 2)`` at joints ``(n, L)``, m."""
        angles = np.cumsum(joints, axis=1)
        return np.cumsum(self.links[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=2), axis=1)

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.tasks.check(tasks)
        first, others, bends = *FOLDED, len(self.links) - 1
        drawn = [start_generator(seed, str(len(self.links))).uniform(-JITTER, JITTER, bends + 1) for seed in seeds]
        self.joints = np.array([first, *[others / bends] * bends]) + np.array(drawn)
        self.goals = np.array([PLACES[task] for task in tasks])
        return self._observe(np.arange(len(tasks)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        invalid = ~np.isfinite(actions).all(axis=1)
        turns = self.speed / HZ * np.clip(np.nan_to_num(actions), -1, 1)
        self.joints[episodes] = np.clip(self.joints[episodes] + turns, -np.pi, np.pi)
        way = self.goals[episodes] - self.points(self.joints[episodes])[:, -1]
        return Step(self._observe(episodes), (np.linalg.norm(way, axis=1) < RADIUS) & ~invalid, invalid)

    def render(self, episodes: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Pictures ``(n, H, W, 3)`` of the arm, and of all places with the episode's own in green."""
        base, goals = np.zeros((len(episodes), 2)) - CENTRE, self.goals[episodes] - CENTRE
        joints = [base, *(self.points(self.joints[episodes]) - CENTRE).swapaxes(0, 1)]
        places = [Discs(base + place, RADIUS, GREY) for place in PLACES.values()]
        links = [Bars(start, end, 0.03, BLUE) for start, end in itertools.pairwise(joints)]
        return draw_plane([*places, Discs(goals, RADIUS, GREEN), *links, Discs(joints[-1], 0.02, BLACK)], REACH, size)

    def _observe(self, episodes: np.ndarray) -> Observation[np.ndarray]:
        joints = self.joints[episodes]
        return Observation(np.concatenate([joints, self.points(joints)[:, -1]], axis=1).astype(np.float32))
