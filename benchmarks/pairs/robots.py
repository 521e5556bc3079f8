"""Kinematic robots of different bodies that reach the same places of a plane: pairs for choosing defaults on.

They differ as the robots of two labs do: in joints, units, action meaning, rate, and in names and order of their keys.
No result quotes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from datamodules.settings import NonNegativeFloat, PositiveFloat, PositiveInt
from datamodules.streams import start_generator
from datamodules.types import DomainSpec, Observation, ObservationKey
from plp_lightning.envs import Expert, Simulator, Step, Tasks

RADII, ANGLES = (0.45, 0.65, 0.85), (2.3, 1.57, 0.84)
PLACES = {f"{r} {a}": (r, a) for r in RADII for a in ANGLES}
NAMES = tuple(f"place_{i}" for i in range(len(PLACES)))
GOALS = np.array([[r * np.cos(a), r * np.sin(a)] for r, a in PLACES.values()])
REACHED = 0.05  # m
SPEED = 0.5  # m/s at full speed


class Reaching(Simulator):
    """A robot that reaches places with its tip; a subclass has the body.

    Args:
        control_hz: Control rate.
        seconds: Time of an episode.
    """

    tasks = Tasks("Reaching", NAMES)
    threads = 1
    joints: int
    actions = 0  # numbers of an action; as many as joints if 0
    start: np.ndarray  # of the joints ``(J,)``
    spread: np.ndarray  # of the starts around it ``(J,)``

    def __init__(self, control_hz: PositiveFloat = 20.0, seconds: PositiveFloat = 4.0) -> None:
        self.control_hz, self.horizon = control_hz, round(control_hz * seconds)

    def keys(self) -> tuple[ObservationKey, ...]:
        """State keys in their order."""
        raise NotImplementedError

    def tip(self, joints: np.ndarray) -> np.ndarray:
        """Places of the tip ``(n, 2)`` for joints ``(n, J)``."""
        raise NotImplementedError

    def limits(self) -> np.ndarray:
        """Full speed of each joint ``(J,)``, per second."""
        raise NotImplementedError

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        """Values of the keys."""
        raise NotImplementedError

    def jacobian(self, joints: np.ndarray) -> np.ndarray:
        """Change of the tip by each joint ``(n, 2, J)``, by differences."""
        step = 1e-5 * np.eye(self.joints)
        return np.stack([(self.tip(joints + d) - self.tip(joints - d)) / 2e-5 for d in step], axis=2)

    def spec(self, name: str) -> DomainSpec:
        return DomainSpec(
            name,
            self.keys(),
            self.actions or self.joints,
            self.control_hz,
            env=f"{type(self).__name__}{self.arguments}",
        )

    def shared_position(self, state: np.ndarray) -> np.ndarray:
        """Place of the tip ``(N, 2)``, which every robot shows, in its own unit and order."""
        return self.seen_tip(state)

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def reset(self, tasks: Sequence[str], seeds: Sequence[int]) -> Observation[np.ndarray]:
        self.goals = GOALS[[NAMES.index(task) for task in tasks]]
        drawn = np.stack([start_generator(seed).uniform(-1, 1, self.joints) for seed in seeds])
        self.joint = self.start + self.spread * drawn
        return self._observe(np.arange(len(tasks)))

    def step(self, actions: np.ndarray, episodes: np.ndarray) -> Step:
        invalid = ~np.isfinite(actions).all(axis=1)
        self.move(episodes, np.clip(np.nan_to_num(actions), -1, 1))
        near = np.linalg.norm(self.tip(self.joint[episodes]) - self.goals[episodes], axis=1) < REACHED
        return Step(self._observe(episodes), near & ~invalid, invalid)

    def move(self, episodes: np.ndarray, actions: np.ndarray) -> None:
        """Let the joints of some episodes follow their actions ``(n, A)`` for a step."""
        self.joint[episodes] += actions * self.limits() / self.control_hz

    def towards(self, joints: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Actions ``(n, A)`` that bring the tip a velocity ``(n, 2)``: joints follow by damped least squares."""
        jacobian = self.jacobian(joints)
        damped = jacobian @ jacobian.transpose(0, 2, 1) + 0.01 * np.eye(2)
        speeds = jacobian.transpose(0, 2, 1) @ np.linalg.solve(damped, velocity[:, :, None])
        return speeds[:, :, 0] / self.limits()

    def _observe(self, episodes: np.ndarray) -> Observation[np.ndarray]:
        shown = self.show(self.joint[episodes])
        return Observation(np.concatenate([shown[key.name] for key in self.keys()], axis=1).astype(np.float32))


class Arm(Reaching):
    """A planar arm, its links together 1 m long, that is told the speeds of its joints.

    Args:
        links: Number of joints.
        degrees: Whether it shows angles in degrees, and its tip in millimetres; it shows its tip first then.
        control_hz: Control rate.
    """

    def __init__(self, links: PositiveInt = 2, degrees: bool = False, control_hz: PositiveFloat = 20.0) -> None:
        super().__init__(control_hz)
        self.joints, self.degrees = links, degrees
        self.lengths = np.full(links, 1.0 / links)
        self.start = np.array([0.3] + [2.4 / (links - 1)] * (links - 1))
        self.spread = np.full(links, 0.25)

    def keys(self) -> tuple[ObservationKey, ...]:
        units = ("deg", "mm") if self.degrees else ("rad", "m")
        found = ObservationKey("joints", (self.joints,), unit=units[0]), ObservationKey("tip", (2,), unit=units[1])
        return found[::-1] if self.degrees else found

    def tip(self, joints: np.ndarray) -> np.ndarray:
        angles = np.cumsum(joints, axis=1)
        return np.stack([np.cos(angles) @ self.lengths, np.sin(angles) @ self.lengths], axis=1)

    def limits(self) -> np.ndarray:
        return np.full(self.joints, 1.5)

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        tip = self.tip(joints)
        return {"joints": np.rad2deg(joints), "tip": 1000 * tip} if self.degrees else {"joints": joints, "tip": tip}

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        return state[:, :2] / 1000 if self.degrees else state[:, -2:]


class Gantry(Reaching):
    """Two rails; it shows y before x, in millimetres, and how far its rails are from their ends.

    Args:
        control_hz: Control rate.
        shift: Place of its origin, m.
    """

    joints = 2

    def __init__(self, control_hz: PositiveFloat = 10.0, shift: NonNegativeFloat = 1.0) -> None:
        super().__init__(control_hz)
        self.shift = shift
        self.start, self.spread = np.array([0.35, 0.2]), np.array([0.25, 0.15])

    def keys(self) -> tuple[ObservationKey, ...]:
        return ObservationKey("rails", (2,), unit="mm"), ObservationKey("left", (2,), unit="mm")

    def tip(self, joints: np.ndarray) -> np.ndarray:
        return joints[:, ::-1] - [self.shift - 1.0, 0.0]

    def limits(self) -> np.ndarray:
        return np.array([-SPEED, SPEED])

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"rails": 1000 * (joints + self.shift), "left": 1000 * (1.0 - joints)}

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        return self.tip(state[:, :2] / 1000 - self.shift)


class Telescope(Reaching):
    """A turret with a boom that grows: angle in degrees, length in centimetres.

    Args:
        control_hz: Control rate.
    """

    joints = 2

    def __init__(self, control_hz: PositiveFloat = 15.0) -> None:
        super().__init__(control_hz)
        self.start, self.spread = np.array([0.4, 0.4]), np.array([0.4, 0.15])

    def keys(self) -> tuple[ObservationKey, ...]:
        return (
            ObservationKey("boom", (1,), unit="cm"),
            ObservationKey("angle", (1,), unit="deg"),
            ObservationKey("tool", (2,), unit="cm"),
        )

    def tip(self, joints: np.ndarray) -> np.ndarray:
        return joints[:, 1:] * np.stack([np.cos(joints[:, 0]), np.sin(joints[:, 0])], axis=1)

    def limits(self) -> np.ndarray:
        return np.array([1.2, SPEED])

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"boom": 100 * joints[:, 1:], "angle": np.rad2deg(joints[:, :1]), "tool": 100 * self.tip(joints)}

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        return state[:, 2:] / 100


class Scissors(Reaching):
    """Two carriages on one rail carry the tip on legs of 0.7 m: their mean moves it along, their gap up and down.

    Args:
        control_hz: Control rate.
    """

    joints, leg = 2, 0.7

    def __init__(self, control_hz: PositiveFloat = 25.0) -> None:
        super().__init__(control_hz)
        self.start, self.spread = np.array([-0.35, 0.85]), np.array([0.12, 0.12])

    def keys(self) -> tuple[ObservationKey, ...]:
        return ObservationKey("carriages", (2,), unit="m"), ObservationKey("hook", (2,), unit="m")

    def tip(self, joints: np.ndarray) -> np.ndarray:
        half = np.abs(joints[:, 1] - joints[:, 0]) / 2
        height = np.sqrt(np.maximum(self.leg**2 - half**2, 1e-4)) + 0.18
        return np.stack([joints.mean(axis=1), height], axis=1)

    def limits(self) -> np.ndarray:
        return np.full(2, SPEED)

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"carriages": joints, "hook": self.tip(joints)}

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        return state[:, 2:]


class Cart(Reaching):
    """A cart that drives forward and turns, so that its way to a place depends on where it looks.

    It shows its direction as cosine and sine, and its place in centimetres.

    Args:
        control_hz: Control rate.
    """

    joints, actions = 3, 2  # x, y and direction; forward speed and turn
    turn = 4.0  # rad/s

    def __init__(self, control_hz: PositiveFloat = 20.0) -> None:
        super().__init__(control_hz)
        self.start, self.spread = np.array([0.2, 0.25, 1.57]), np.array([0.25, 0.1, 1.0])

    def keys(self) -> tuple[ObservationKey, ...]:
        return ObservationKey("direction", (2,)), ObservationKey("place", (2,), unit="cm")

    def tip(self, joints: np.ndarray) -> np.ndarray:
        return joints[:, :2]

    def move(self, episodes: np.ndarray, actions: np.ndarray) -> None:
        self.joint[episodes, 2] += actions[:, 1] * self.turn / self.control_hz
        forward = np.maximum(actions[:, 0], -0.2) * SPEED / self.control_hz
        looks = self.joint[episodes, 2]
        self.joint[episodes, :2] += forward[:, None] * np.stack([np.cos(looks), np.sin(looks)], axis=1)

    def towards(self, joints: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        off = np.arctan2(velocity[:, 1], velocity[:, 0]) - joints[:, 2]
        off = (off + np.pi) % (2 * np.pi) - np.pi
        forward = np.linalg.norm(velocity, axis=1) / SPEED * np.maximum(np.cos(off), 0)
        return np.stack([forward, 6.0 * off / self.turn], axis=1)

    def show(self, joints: np.ndarray) -> Mapping[str, np.ndarray]:
        looks = joints[:, 2:]
        return {"direction": np.concatenate([np.cos(looks), np.sin(looks)], axis=1), "place": 100 * joints[:, :2]}

    def seen_tip(self, state: np.ndarray) -> np.ndarray:
        return state[:, 2:] / 100


class ReachingExpert(Expert):
    """Goes straight to the place, slower when it is near; the robot says which action that is."""

    def begin(self, simulator: Simulator, tasks: Sequence[str], seeds: Sequence[int]) -> None:
        assert isinstance(simulator, Reaching)
        self.simulator = simulator

    def act(self, observation: Observation[np.ndarray], episodes: np.ndarray) -> np.ndarray:
        robot = self.simulator
        joints = robot.joint[episodes]
        velocity = 2.0 * (robot.goals[episodes] - robot.tip(joints))
        velocity /= np.maximum(1.0, np.linalg.norm(velocity, axis=1, keepdims=True) / SPEED)
        return np.clip(robot.towards(joints, velocity), -1, 1).astype(np.float32)
