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
from plp_lightning.envs.native import Desk, load, save
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
    camera: Camera


class TabletopPhysics(Engine[Room]):
    """The last observations of E episodes, which so many ``threads`` step and draw; 0 means one for each core."""

    def __init__(self, scene: TabletopModel, viewpoint: Viewpoint, image_size: int, threads: int) -> None:
        self.scene, self.viewpoint, self.image_size = scene, viewpoint, image_size
        super().__init__(scene.model, threads)

    def room(self, data: mujoco.MjData) -> Room:
        return Room(data, Desk.of(self.model, data), Camera(self.model, self.viewpoint, self.image_size))

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
            state = self.states[row]
            valid[i] = valid[i] and load(room.desk, state)
            if valid[i]:
                self._hold(room, actions[i])
                valid[i] = save(room.desk, state)
            if valid[i]:
                self._look(room, row)

    def _hold(self, room: Room, action: np.ndarray) -> None:
        data, follower = room.data, self.scene.follower
        action = np.clip(action, -1.0, 1.0)
        data.mocap_pos[follower] = np.clip(data.mocap_pos[follower] + action[:3] * ACTION_SCALE, *WORKSPACE)
        data.mocap_quat[follower] = DOWN
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(self.scene.model, data, nstep=SUBSTEPS)
        mujoco.mj_forward(self.scene.model, data)

    def _look(self, room: Room, row: int) -> None:
        data, scene, seen = room.data, self.scene, self.observed[row]
        right, left = (data.xpos[claw] for claw in scene.claws)
        seen[4:] = seen[:4]
        seen[:3] = data.xpos[scene.hand]
        seen[3] = min(np.linalg.norm(right - left) / WIDEST_GRIP, 1.0)
        self.sites[row] = data.site_xpos[scene.sites]
        room.camera.image(data, self.images[row])
