"""Two robots as environments of Gymnasium, and their demonstrations: ``python two_robots.py`` records both.

A gantry and an arm bring their tips to nine places. They differ as robots of two labs do: in joints, keys and units.
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from PIL import Image, ImageDraw

import plp_lightning as plp

HEIGHTS, SIDES = {"high": 0.8, "middle": 0.6, "low": 0.4}, {"left": -0.4, "centre": 0.0, "right": 0.4}
PLACES = {f"{h}_{s}": np.array([x, y]) for h, y in HEIGHTS.items() for s, x in SIDES.items()}  # m
TARGET = "high_centre"


class Robot(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """A body that brings its tip to a place and rests there; a subclass has the body. Time passes 20 times a second."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}
    start: np.ndarray  # joints
    limit: float  # greatest action

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode, joints = render_mode, len(self.start)
        self.action_space = spaces.Box(-self.limit, self.limit, (joints,), np.float32)
        boxes = {key: spaces.Box(-np.inf, np.inf, value.shape) for key, value in self.show(self.start).items()}
        self.observation_space = spaces.Dict(boxes)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.goal = PLACES[(options or {}).get("task", TARGET)]
        self.joints = self.start + self.np_random.uniform(-0.25, 0.25, len(self.start))
        self.rested = 0
        return self.show(self.joints), {}

    def step(self, action: np.ndarray) -> Any:
        self.joints = self.joints + self.moved(np.clip(action, -self.limit, self.limit))
        near = bool(np.linalg.norm(self.points(self.joints)[-1] - self.goal) < 0.05)
        self.rested = self.rested + 1 if near else 0
        return self.show(self.joints), float(near), self.rested == 10, False, {"is_success": near}

    def expert(self) -> np.ndarray:
        """Action of a demonstrator: the tip goes straight to the goal, at 0.5 m/s at most."""
        way = 2 * (self.goal - self.points(self.joints)[-1])
        velocity = way * min(1, 0.5 / max(np.linalg.norm(way), 1e-6))
        shifts = [self.points(self.joints + shift)[-1] for shift in 1e-4 * np.eye(len(self.joints))]
        jacobian = (np.array(shifts) - self.points(self.joints)[-1]).T / 1e-4
        speeds = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 0.01 * np.eye(2), velocity)
        return np.clip(speeds / 20 / self.moved(1.0), -self.limit, self.limit).astype(np.float32)

    def render(self) -> np.ndarray:
        """Picture of it, ``(192, 192, 3)``."""
        image = Image.new("RGB", (192, 192), "white")
        draw = ImageDraw.Draw(image)
        corners = [(96 + 100 * x, 176 - 160 * y) for x, y in [*self.points(self.joints), self.goal]]
        (tip_x, tip_y), (x, y) = corners[-2:]
        draw.ellipse((x - 9, y - 9, x + 9, y + 9), fill="orange")
        draw.line(corners[:-1], fill="steelblue", width=6)
        draw.ellipse((tip_x - 4, tip_y - 4, tip_x + 4, tip_y + 4), fill="black")
        return np.asarray(image)


class Gantry(Robot):
    """A carriage on a bridge; it shows its tip in millimetres, y before x, and moves by millimetres a step."""

    start, limit = np.array([0.65, 0.5]), 40.0

    def moved(self, action: Any) -> Any:
        return action / 1000

    def points(self, joints: np.ndarray) -> np.ndarray:
        x, y = joints
        return np.array([(-0.9, y), (0.9, y), (x, y)])

    def show(self, joints: np.ndarray) -> dict[str, np.ndarray]:
        return {"carriage": 1000 * joints[::-1].astype(np.float32)}


class Arm(Robot):
    """Two links of half a metre; it shows its joints in radians and its tip in metres, and is told speeds in rad/s."""

    start, limit = np.array([0.05, 1.2]), 2.0

    def moved(self, action: Any) -> Any:
        return action / 20

    def points(self, joints: np.ndarray) -> np.ndarray:
        angles = np.cumsum(joints)
        return np.cumsum([(0, 0), *zip(0.5 * np.cos(angles), 0.5 * np.sin(angles), strict=True)], axis=0)

    def show(self, joints: np.ndarray) -> dict[str, np.ndarray]:
        return {"joints": joints.astype(np.float32), "tip": self.points(joints)[-1].astype(np.float32)}


gymnasium.register("Gantry-v0", Gantry, max_episode_steps=80)
gymnasium.register("Arm-v0", Arm, max_episode_steps=80)


def record(robot: str, tasks: list[str], episodes: int) -> None:
    """Keep demonstrations of tasks in the folder ``recordings/<robot>``."""
    env = plp.Recorder(gymnasium.make(f"{robot.capitalize()}-v0"), f"recordings/{robot}")
    for task in tasks:
        for seed in range(episodes):
            env.reset(seed=seed, options={"task": task})
            over = False
            while not over:
                *_, terminated, truncated, _ = env.step(env.unwrapped.expert())
                over = terminated or truncated


if __name__ == "__main__":
    record("gantry", list(PLACES), 20)
    record("arm", [task for task in PLACES if task != TARGET], 20)  # it is never shown the target task
