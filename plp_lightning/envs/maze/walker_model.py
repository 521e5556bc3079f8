"""The walkers' bodies: one parametrised MJCF gives Gymnasium's four-legged ant and a six-legged spider."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

GEAR = 150.0  # torque of a motor at action 1, in N m


class Box(NamedTuple):
    """A wall block that stands on the floor, sides along the axes."""

    x: float  # centre, in m
    y: float
    half_width: float
    half_height: float


def wall_geoms(walls: Sequence[Box]) -> str:
    """MJCF geoms of all blocks, named ``wall_0``, ``wall_1``, … in order, which collide with everything."""
    return "\n".join(
        f'<geom name="wall_{i}" type="box" pos="{x} {y} {height}" size="{width} {width} {height}" contype="1" '
        'conaffinity="1"/>'
        for i, (x, y, width, height) in enumerate(walls)
    )


def walker_mjcf(legs: int, walls: Sequence[Box] = ()) -> str:
    """MJCF of a torso on ``legs`` two-jointed legs at equal angles, on a plane with ``walls``.

    Four legs give the dynamics of Gymnasium's ``ant.xml`` to the last bit: the same lengths, joint axes and ranges, and
    the same order of bodies, joints and motors. The i-th of 1…n legs stands at an angle of (2 i - 1) π / n.
    See https://github.com/Farama-Foundation/Gymnasium/blob/main/gymnasium/envs/mujoco/assets/ant.xml.
    """
    leg_bodies = "\n".join(_leg(i, (2 * i - 1) * math.pi / legs) for i in range(1, legs + 1))
    # Gymnasium's ant lists the motors of its last leg first.
    motors = "\n".join(_motors(i) for i in (legs, *range(1, legs)))
    return f"""
<mujoco model="walker">
  <compiler angle="degree" inertiafromgeom="true"/>
  <option integrator="RK4" timestep="0.01"/>
  <default>
    <joint armature="1" damping="1" limited="true"/>
    <geom conaffinity="0" condim="3" density="5" friction="1 0.5 0.5" margin="0.01" rgba="0.8 0.6 0.4 1"/>
  </default>
  <worldbody>
    <light directional="true" pos="0 0 1.3" dir="0 0 -1.3" diffuse="1 1 1" specular="0.1 0.1 0.1"/>
    <geom name="floor" type="plane" size="40 40 40" conaffinity="1" rgba="0.8 0.9 0.8 1"/>
    {wall_geoms(walls)}
    <body name="torso" pos="0 0 0.75">
      <geom name="torso" type="sphere" size="0.25"/>
      <joint name="root" type="free" armature="0" damping="0" limited="false" margin="0.01"/>
      {leg_bodies}
    </body>
  </worldbody>
  <actuator>
    {motors}
  </actuator>
</mujoco>"""


def _leg(index: int, angle: float) -> str:
    """One leg that points outwards at ``angle`` (rad): a fixed stub, a hip about z, an ankle that bends down."""
    ahead, aside = math.cos(angle), math.sin(angle)
    thigh, shin = _point(ahead, aside, math.sqrt(0.08)), _point(ahead, aside, math.sqrt(0.32))
    # The ant's ankle axes all point to the +y side, so the legs behind bend by negative angles.
    side = 1 if ahead > -1e-9 else -1
    axis = _point(-side * aside, side * ahead, math.sqrt(2))
    low, high = sorted((30 * side, 70 * side))
    return f"""
      <body name="leg_{index}">
        <geom type="capsule" fromto="0 0 0 {thigh}" size="0.08"/>
        <body name="thigh_{index}" pos="{thigh}">
          <joint name="hip_{index}" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom type="capsule" fromto="0 0 0 {thigh}" size="0.08"/>
          <body name="shin_{index}" pos="{thigh}">
            <joint name="ankle_{index}" type="hinge" axis="{axis}" range="{low} {high}"/>
            <geom type="capsule" fromto="0 0 0 {shin}" size="0.08"/>
          </body>
        </body>
      </body>"""


def _point(ahead: float, aside: float, length: float) -> str:
    """A point in the plane as text, rounded so that the ant's diagonals are exactly 0.2 and 0.4."""
    return f"{length * ahead:.12g} {length * aside:.12g} 0"


def _motors(leg: int) -> str:
    limits = f'ctrllimited="true" ctrlrange="-1 1" gear="{GEAR}"'
    return f'<motor joint="hip_{leg}" {limits}/><motor joint="ankle_{leg}" {limits}/>'
