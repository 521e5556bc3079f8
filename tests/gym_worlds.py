"""Small environments of Gymnasium: a point on a plate, which is turned by an angle."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

GOALS = {"east": 0.0, "north": np.pi / 2, "west": np.pi, "south": 3 * np.pi / 2}


class Plate(gymnasium.Env[dict[str, Any], np.ndarray]):
    """A point that is pushed to one of four edges; what it sees and does is turned by an angle.

    Over the edge it falls, which ends the episode.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self, turn: float = 0.0, camera: bool = False, breaks_at: int = -1, render_mode: str | None = None
    ) -> None:
        self.render_mode, self.camera, self.breaks_at = render_mode, camera, breaks_at
        self.turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        seen: dict[str, Any] = {
            "place": spaces.Box(-9, 9, (2,)),
            "clock": spaces.Discrete(100),
            "about": spaces.Text(20),
        }
        if camera:
            seen["eye"] = spaces.Box(0, 255, (8, 8, 3), np.uint8)
        self.observation_space = spaces.Dict(seen)
        self.action_space = spaces.Box(-0.4, 0.2, (2,))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.goal = np.array([np.cos(angle := GOALS[(options or {})["goal"]]), np.sin(angle)])
        self.point, self.time = self.np_random.uniform(-0.2, 0.2, 2), 0
        return self._seen(), {}

    def step(self, action: np.ndarray) -> Any:
        assert self.action_space.contains(action), f"{action} is none of {self.action_space}"
        self.point, self.time = self.point + action @ self.turned, self.time + 1
        if self.time == self.breaks_at:
            raise FloatingPointError("the plate is broken")
        there = bool(np.linalg.norm(self.point - self.goal) < 0.3)
        return self._seen(), float(there), bool(np.abs(self.point).max() > 1.2), False, {"is_success": there}

    def render(self) -> np.ndarray:
        picture = np.full((20, 20, 3), 255, np.uint8)
        row, column = (np.clip(self.point * 8 + 10, 0, 19)).astype(int)
        picture[row, column] = 0
        return picture

    def _seen(self) -> dict[str, Any]:
        place = (self.point @ self.turned.T).astype(np.float32)
        seen: dict[str, Any] = {"place": place, "clock": self.time, "about": "a plate"}
        return seen | ({"eye": np.full((8, 8, 3), self.time, np.uint8)} if self.camera else {})


class Elsewhere(gymnasium.Env[np.ndarray, int]):
    """An environment with whole numbers as actions."""

    observation_space = spaces.Box(-1, 1, (2, 2))
    action_space = spaces.Discrete(3)


gymnasium.register("Plate-v0", Plate, max_episode_steps=30)
