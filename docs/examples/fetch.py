"""Gymnasium-Robotics' Fetch as it is and as another lab has it, with other axes and another unit; a task is a place."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import gymnasium_robotics  # noqa: F401  (registers FetchReach-v4)
import numpy as np

from datamodules.types import Observation
from plp_lightning.envs import Expert, Gymnasium, Simulator

MIDDLE = np.array([1.34, 0.75, 0.53])  # of the places, metres; x leads away from the robot
PLACES = {
    f"{row}_{side}": MIDDLE + np.array([x, y, 0.0])
    for row, x in {"near": -0.12, "middle": 0.0, "far": 0.12}.items()
    for side, y in {"left": 0.14, "centre": 0.0, "right": -0.14}.items()
}
START_STEPS = 8  # of one random action, so that each episode begins elsewhere


def turned(places: np.ndarray, turns: int) -> np.ndarray:
    """Vectors ``(…, 3)`` after so many quarter turns about the upright axis."""
    cos, sin = (int(number) for number in (np.cos(turns * np.pi / 2).round(), np.sin(turns * np.pi / 2).round()))
    return places @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


class Fetch(gymnasium.Wrapper):
    """FetchReach whose goal is the place of the option ``task``; the gripper's state is seen in a frame of its own.

    Args:
        turns: Quarter turns of that frame.
        unit: Units of length in a metre.
        render_mode: As of FetchReach.
    """

    def __init__(self, turns: int = 0, unit: float = 1.0, render_mode: str = "rgb_array") -> None:
        super().__init__(gymnasium.make("FetchReach-v4", disable_env_checker=True, render_mode=render_mode))
        self.turns, self.unit = turns, unit
        parts = {name: gymnasium.spaces.Box(-np.inf, np.inf, (3,)) for name in ("place", "velocity")}
        self.observation_space, self.action_space = gymnasium.spaces.Dict(parts), gymnasium.spaces.Box(-1, 1, (3,))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.env.reset(seed=seed)
        self.unwrapped.goal = PLACES[(options or {"task": "middle_centre"})["task"]]
        away = [*np.random.default_rng(seed).uniform(-1, 1, 3), 0.0]
        for _ in range(START_STEPS):
            seen = self.env.unwrapped.step(np.float32(away))[0]
        return self._seen(seen), {}

    def step(self, action: np.ndarray) -> Any:
        seen, *rest = self.env.step(np.float32([*turned(action, -self.turns), 0.0]))
        return self._seen(seen), *rest

    def _seen(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        place, velocity = seen["observation"][:3], seen["observation"][5:8]
        parts = {"place": place - MIDDLE, "velocity": velocity}
        return {name: np.float32(self.unit * turned(part, self.turns)) for name, part in parts.items()}


class FetchExpert(Expert):
    """Goes straight to the place, slower when it is near."""

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        assert isinstance(simulator, Gymnasium)
        known = {"turns": 0, "unit": 1.0, **simulator.factory.make}
        self.unit, self.goals = known["unit"], turned(np.array([PLACES[t] - MIDDLE for t in tasks]), known["turns"])

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        return np.clip(8.0 * (self.goals[episodes] - observation.state[:, :3] / self.unit), -1, 1).astype(np.float32)
