"""Many episodes of one tabletop scene, stepped and drawn together by the engine's threads, each with its own camera.

MuJoCo lets go of Python's lock while it steps and draws, so that threads use all cores.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.engine import Engine
from plp_lightning.envs.native import Desk, entry, load, mj_forward, mj_step, save
from plp_lightning.envs.rendering.camera import Camera, Viewpoint
from plp_lightning.envs.tabletop.layout import Layout
from plp_lightning.envs.tabletop.model import TabletopModel

SUBSTEPS = 5  # physics steps for each control step, of 2.5 ms each
SETTLING = 50 * SUBSTEPS  # physics steps in which the hand gets to its start
ACTION_SCALE = 1.0 / 100  # way of the point that the hand follows for an action of 1, m
DOWN = (1.0, 0.0, 1.0, 0.0)  # orientation of that point
WORKSPACE = np.array([[-0.5, 0.40, 0.05], [0.5, 1.0, 0.5]])  # least and greatest place of that point, m
WIDEST_GRIP = 0.1  # distance of the claws that counts as 1, m


class Room(NamedTuple):
    """The things that a thread works with."""

    data: mujoco.MjData
    desk: Desk
    place: np.ndarray  # (3,): of the point that the hand follows, in data
    turn: np.ndarray  # (4,): its orientation
    camera: Camera


class TabletopPhysics(Engine[Room]):
    """The last observations of E episodes, which so many ``threads`` step and draw; 0 means one for each core."""

    def __init__(self, scene: TabletopModel, viewpoint: Viewpoint, image_size: int, threads: int) -> None:
        self.scene, self.viewpoint, self.image_size = scene, viewpoint, image_size
        super().__init__(scene.model, threads)

    def room(self, data: mujoco.MjData) -> Room:
        place, turn = data.mocap_pos[self.scene.follower], data.mocap_quat[self.scene.follower]
        camera = Camera(self.model, self.viewpoint, self.image_size)
        return Room(data, Desk.of(self.model, data), place, turn, camera)

    def reset(self, layouts: Sequence[Layout]) -> Observation[np.ndarray]:
        """Begin E episodes, one for each layout; their first observations ``(E, …)``."""
        count, size = len(layouts), self.image_size
        self.begin(count)
        self.observed = np.zeros((count, 8), dtype=np.float32)
        self.sites = np.zeros((count, len(self.scene.sites), 3))
        self.images = np.zeros((count, size, size, 3), dtype=np.uint8)
        self.share(count, lambda room, part: self._start(room, part, layouts))
        self.observed[:, 4:] = self.observed[:, :4]
        return self._observation(np.arange(count))

    def step(self, actions: np.ndarray, rows: np.ndarray) -> tuple[Observation[np.ndarray], np.ndarray]:
        """Observations ``(n, …)`` after one control step of rows ``(n,)``, and a mask ``(n,)`` of the invalid ones."""
        valid = self.advance(rows, actions, self._change)
        return self._observation(rows), ~valid

    def _observation(self, rows: np.ndarray) -> Observation[np.ndarray]:
        return Observation(self.observed[rows], {"image": self.images[rows]})

    def _start(self, room: Room, part: slice, layouts: Sequence[Layout]) -> None:
        for row in range(part.start, part.stop):
            load(room.desk, self.states[row])
            self._settle(room.data, layouts[row])
            save(room.desk, self.states[row])
            self._look(room, row)

    def _settle(self, data: mujoco.MjData, layout: Layout) -> None:
        model, scene = self.scene.model, self.scene
        data.mocap_pos[scene.furniture] = layout.furniture
        data.mocap_pos[scene.follower], data.mocap_quat[scene.follower] = layout.hand, DOWN
        data.ctrl[:] = -1.0, 1.0
        mujoco.mj_step(model, data, nstep=SETTLING)
        data.qpos[scene.object_qpos] = layout.object
        data.qvel[scene.object_qvel] = 0.0
        # Meta-World leaves out this call, and shows where things stood before.
        mujoco.mj_forward(model, data)

    def _change(self, room: Room, rows: np.ndarray, actions: np.ndarray, valid: np.ndarray) -> None:
        for i, row in enumerate(rows):
            valid[i] = valid[i] and _advance(room.desk, room.place, room.turn, self.states[row], actions[i])
            if valid[i]:
                self._look(room, row)

    def _look(self, room: Room, row: int) -> None:
        data, scene, seen = room.data, self.scene, self.observed[row]
        right, left = (data.xpos[claw] for claw in scene.claws)
        seen[4:] = seen[:4]
        seen[:3] = data.xpos[scene.hand]
        seen[3] = min(np.linalg.norm(right - left) / WIDEST_GRIP, 1.0)
        self.sites[row] = data.site_xpos[scene.sites]
        room.camera.image(data, self.images[row])


@entry
def _advance(desk: Desk, place: np.ndarray, turn: np.ndarray, state: np.ndarray, action: np.ndarray) -> bool:
    """Hold an action ``(4,)`` for one control step of a row's state; False if it diverged, and then it stays."""
    if not load(desk, state):
        return False
    for axis in range(3):
        way = min(max(action[axis], -1.0), 1.0) * ACTION_SCALE
        place[axis] = min(max(place[axis] + way, WORKSPACE[0, axis]), WORKSPACE[1, axis])
    for part in range(4):
        turn[part] = DOWN[part]
    grip = min(max(action[3], -1.0), 1.0)
    desk.ctrl[0], desk.ctrl[1] = grip, -grip
    for _ in range(SUBSTEPS):
        mj_step(desk.model, desk.data)
    mj_forward(desk.model, desk.data)  # Meta-World leaves it out, and shows where things stood before
    return save(desk, state)
