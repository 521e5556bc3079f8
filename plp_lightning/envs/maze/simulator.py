"""Point, ant and spider in D4RL's mazes, on the physics of Gymnasium-Robotics, many episodes at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from datamodules.settings import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from datamodules.types import ObservationKey
from plp_lightning.envs.maze.base import FrameName, LayoutName, Maze
from plp_lightning.envs.maze.layout import Frame
from plp_lightning.envs.maze.walker_model import Box, walker_mjcf, wall_geoms

FLIP = np.diag([1.0, -1.0])  # (x, y) → (x, -y), as a matrix that rows are multiplied with
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # (x, y) → (-y, x), likewise


class PointMaze(Maze):
    """A force-driven ball: Gymnasium-Robotics' ``PointMaze_UMaze-v3`` and ``PointMaze_Medium-v3``.

    The state is ``position (2), velocity (2)``, the action a force along each axis; a control step lasts 10 ms.
    The paper's source domain of P2P is ``swap_axes=True, negate_actions=True``: it sees (y, x, vy, vx) and its
    actions have the opposite sign, but their axes are not swapped.

    Further agents look at the same maze through a frame of their own, in which they are also moved: with F, Q and
    the swap S as matrices and l the length of a metre, p S F Q l is what is seen of a position or velocity p (a
    row), and ± u F Q the action for a force u. All maps send the box of actions to itself, and exactly.

    Args:
        layout: Maze, by name.
        swap_axes: Show y before x (S).
        negate_actions: Turn the sign of all actions.
        mirror: Turn the sign of y (F).
        quarter_turns: Turns of the frame by 90° each, x towards y (Q).
        metre: Number that is shown for a metre, and for a metre per second (l); forces stay shares of the largest.
        frame: ``d4rl``: x grows with the rows of the maze, as in the paper's data; ``gymnasium``: the frame of
            Gymnasium-Robotics, origin in the middle, the same for all bodies.
        radius: Distance from the goal that counts as success, in cells of 1 m.
        jitter: Largest offset of a start from its cell's centre along each axis, in cells.
        horizon: Control steps of an episode; None means 250 in umaze and 400 in medium (D4RL: 300 and 600).
        threads: Threads that step physics; 0 means one for each core.
    """

    scale = 1.0
    frame_skip = 1
    horizons: ClassVar[dict[str, int]] = {"umaze": 250, "medium": 400}

    def __init__(
        self,
        layout: LayoutName,
        swap_axes: bool = False,
        negate_actions: bool = False,
        mirror: bool = False,
        quarter_turns: int = 0,
        metre: PositiveFloat = 1.0,
        frame: FrameName = "d4rl",
        radius: NonNegativeFloat = 0.5,
        jitter: NonNegativeFloat = 0.25,
        horizon: PositiveInt | None = None,
        threads: NonNegativeInt = 0,
    ) -> None:
        super().__init__(layout, frame, radius, jitter, horizon, threads)
        turned = (FLIP if mirror else np.eye(2)) @ np.linalg.matrix_power(TURN, quarter_turns % 4)
        self._seen, self._metre = (np.eye(2)[::-1] if swap_axes else np.eye(2)) @ turned, metre
        self._moved = -turned if negate_actions else turned
        self._description += f", swap_axes {swap_axes}, negate_actions {negate_actions}"
        if mirror or quarter_turns or metre != 1:  # what files of plain agents say stays the same
            self._description += f", mirror {mirror}, quarter_turns {quarter_turns}, metre {metre}"

    def states_in_maze(self, states: np.ndarray) -> np.ndarray:
        found: np.ndarray = _planar(states, self._seen.T) / states.dtype.type(self._metre)
        return found

    def states_of_domain(self, states: np.ndarray) -> np.ndarray:
        seen: np.ndarray = _planar(states, self._seen) * states.dtype.type(self._metre)
        return seen

    def actions_in_maze(self, actions: np.ndarray) -> np.ndarray:
        return _planar(actions, self._moved.T)

    def actions_of_domain(self, actions: np.ndarray) -> np.ndarray:
        return _planar(actions, self._moved)

    _body = "point"
    _action_size = 2
    _wall_height = 0.4
    _forward = True  # it limits the velocity by setting the state

    def _keys(self) -> tuple[ObservationKey, ...]:
        return ObservationKey("position", (2,), unit="m"), ObservationKey("velocity", (2,), unit="m/s")

    def _d4rl_frame(self) -> Frame:
        # In D4RL the ball's joints are zero at 1.2, the walls stand at whole numbers from 1.
        return Frame((-0.2, -0.2), (1.0, 0.0), (0.0, 1.0))

    def _before_step(self, rows: np.ndarray) -> None:
        states, qvel = self._physics.states, self._physics.qvel
        states[rows, qvel] = np.clip(states[rows, qvel], -5.0, 5.0)

    def _mjcf(self, walls: Sequence[Box]) -> str:
        # The dynamics of gymnasium_robotics/envs/assets/point/point.xml, to the last bit.
        return f"""
<mujoco model="point">
  <compiler inertiafromgeom="true" angle="radian"/>
  <option timestep="0.01" gravity="0 0 0" iterations="20" integrator="Euler"/>
  <default>
    <joint damping="1" limited="false"/>
    <geom friction="0.5 0.1 0.1" density="1000" margin="0.002" condim="1" contype="2" conaffinity="1"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 0.25" pos="0 0 -0.1" contype="1" conaffinity="0"/>
    {wall_geoms(walls)}
    <body name="ball">
      <geom name="ball" type="sphere" size="0.1" contype="1"/>
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="x" ctrlrange="-1 1" ctrllimited="true" gear="100"/>
    <motor joint="y" ctrlrange="-1 1" ctrllimited="true" gear="100"/>
  </actuator>
</mujoco>"""


class WalkerMaze(Maze):
    """A legged walker: Gymnasium-Robotics' ``AntMaze_UMaze-v4`` and ``AntMaze_Medium-v4``, or a six-legged spider.

    The state is ``position (2), height, quat (4, w first), joints, velocity (3), angular_velocity (3, body frame),
    joint_velocities``: 29 numbers for four legs, 37 for six. The action is a torque for each of the two joints
    of a leg; a control step lasts 50 ms.

    Args:
        layout: Maze, by name.
        legs: 4 for the ant, 6 for the spider.
        frame: ``d4rl``: x grows with the columns of the maze, as in the paper's data; ``gymnasium``: the frame of
            Gymnasium-Robotics, origin in the middle, the same for all bodies.
        radius: Distance from the goal that counts as success, in cells of 4 m.
        jitter: Largest offset of a start from its cell's centre along each axis, in cells.
        horizon: Control steps of an episode; None means 700 in umaze and 1200 in medium (D4RL: 700 and 1000
            steps of 100 ms).
        threads: Threads that step physics; 0 means one for each core.
    """

    scale = 4.0
    frame_skip = 5
    horizons: ClassVar[dict[str, int]] = {"umaze": 700, "medium": 1200}

    def __init__(
        self,
        layout: LayoutName,
        legs: Literal[4, 6] = 4,
        frame: FrameName = "d4rl",
        radius: NonNegativeFloat = 0.5,
        jitter: NonNegativeFloat = 0.25,
        horizon: PositiveInt | None = None,
        threads: NonNegativeInt = 0,
    ) -> None:
        # Each leg has two joints, each with a motor.
        self.legs, self._action_size, self._body = legs, 2 * legs, f"walker with {legs} legs"
        super().__init__(layout, frame, radius, jitter, horizon, threads)

    _wall_height = 2.0
    _forward = False

    def _keys(self) -> tuple[ObservationKey, ...]:
        return (
            ObservationKey("position", (2,), unit="m"),
            ObservationKey("height", (1,), unit="m"),
            ObservationKey("quat", (4,)),
            ObservationKey("joints", (2 * self.legs,), unit="rad"),
            ObservationKey("velocity", (3,), unit="m/s"),
            ObservationKey("angular_velocity", (3,), unit="rad/s"),
            ObservationKey("joint_velocities", (2 * self.legs,), unit="rad/s"),
        )

    def _d4rl_frame(self) -> Frame:
        # D4RL puts the origin at cell (1, 1) and lets y grow downwards.
        return Frame((-4.0, -4.0), (0.0, 4.0), (4.0, 0.0))

    def _mjcf(self, walls: Sequence[Box]) -> str:
        return walker_mjcf(self.legs, walls)


def _planar(vectors: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Every two columns of vectors ``(n, 2 m)`` times a matrix, in the precision that they came in."""
    turned: np.ndarray = vectors.reshape(-1, 2) @ matrix.astype(vectors.dtype)
    return turned.reshape(vectors.shape)
