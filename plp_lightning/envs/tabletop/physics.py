"""Many episodes of one tabletop scene, stepped and drawn together by threads.

An episode is a row of MuJoCo's state. Each thread has its own ``MjData`` and its own camera: MuJoCo lets go
of Python's lock while it steps and draws, so that threads use all cores.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import mujoco
import numpy as np

from datamodules.types import Observation
from plp_lightning.envs.rendering.camera import Camera, Viewpoint
from plp_lightning.envs.tabletop.model import TabletopModel

STATE = int(
    mujoco.mjtState.mjSTATE_FULLPHYSICS
    | mujoco.mjtState.mjSTATE_WARMSTART
    | mujoco.mjtState.mjSTATE_CTRL
    | mujoco.mjtState.mjSTATE_MOCAP_POS
    | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)
SUBSTEPS = 5
"""Physics steps for each control step, of 2.5 ms each."""
SETTLING = 50 * SUBSTEPS
"""Physics steps in which the hand gets to its start."""
ACTION_SCALE = 1.0 / 100
"""Way of the point that the hand follows for an action of 1, m."""
DOWN = (1.0, 0.0, 1.0, 0.0)
"""Orientation of that point."""
WORKSPACE = np.array([[-0.5, 0.40, 0.05], [0.5, 1.0, 0.5]])
"""Where that point may be, m."""
WIDEST_GRIP = 0.1
"""Distance of the claws that counts as 1, m."""
DIVERGED = 1e6
"""A state beyond this in any coordinate has blown up."""


class Layout(NamedTuple):
    """How one episode begins."""

    hand: np.ndarray
    """Where the hand starts, ``(3,)``, m."""
    furniture: np.ndarray
    """Places ``(m, 3)`` of the balls, or of the window, m."""
    object: np.ndarray
    """Position of the puck ``(3,)``, or how far the window is open ``(1,)``, m."""


class _Room(threading.local):
    """What a thread of one pool works with. It dies with its thread, in its thread, as an OpenGL context must."""

    data: mujoco.MjData | None = None
    camera: Camera


# Of the module, not of a simulator: that may be let go by another thread, which would free another context's pictures.
_room = _Room()


class TabletopPhysics:
    """The states and last observations of E episodes, and the threads that advance them.

    Args:
        scene: What is simulated.
        viewpoint: Where the camera stands.
        image_size: Height and width of the images, pixels.
        threads: How many.
    """

    def __init__(self, scene: TabletopModel, viewpoint: Viewpoint, image_size: int, threads: int) -> None:
        self.scene, self.viewpoint, self.image_size, self.threads = scene, viewpoint, image_size, threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="tabletop")
        self._make_room(0)

    def reset(self, layouts: Sequence[Layout]) -> Observation[np.ndarray]:
        """Begin an episode for each layout."""
        self._make_room(len(layouts))
        self._share(np.arange(len(layouts)), lambda i, data: self._begin(i, layouts[i], data))
        self.observed[:, 4:] = self.observed[:, :4]
        return self._observation(np.arange(len(layouts)))

    def step(self, actions: np.ndarray, rows: np.ndarray) -> tuple[Observation[np.ndarray], np.ndarray]:
        """One control step of ``rows (n,)``; an invalid one leaves its episode as it was.

        Returns:
            Observations of the rows, and which are invalid, ``(n,)`` bool.
        """
        invalid = np.zeros(len(rows), dtype=np.bool_)

        def advance(i: int, data: mujoco.MjData) -> bool:
            invalid[i] = not self._advance(rows[i], actions[i], data)
            return not invalid[i]

        self._share(rows, advance)
        return self._observation(rows), invalid

    def _make_room(self, episodes: int) -> None:
        size = self.image_size
        self.states = np.zeros((episodes, mujoco.mj_stateSize(self.scene.model, STATE)))
        self.observed = np.zeros((episodes, 8), dtype=np.float32)
        self.sites = np.zeros((episodes, len(self.scene.sites), 3))
        self.images = np.zeros((episodes, size, size, 3), dtype=np.uint8)

    def _observation(self, rows: np.ndarray) -> Observation[np.ndarray]:
        return Observation(self.observed[rows], self.images[rows])

    def _share(self, rows: np.ndarray, change: Callable[[int, mujoco.MjData], bool]) -> None:
        """Change the i-th of ``rows`` in a thread's MjData, for all i, and look at what changed."""
        queue = deque(range(len(rows)))

        def work() -> None:
            room = self._enter()
            # One at a time, so that no thread waits long for the last.
            while queue:
                try:
                    i = queue.popleft()
                except IndexError:  # another thread took it
                    return
                if change(i, room.data):
                    self._look(rows[i], room)

        for job in [self._pool.submit(work) for _ in range(min(self.threads, len(rows)))]:
            job.result()

    def _enter(self) -> _Room:
        if _room.data is None:
            _room.camera = Camera(self.scene.model, self.viewpoint, self.image_size)
            _room.data = mujoco.MjData(self.scene.model)
        return _room

    def _begin(self, row: int, layout: Layout, data: mujoco.MjData) -> bool:
        model, scene = self.scene.model, self.scene
        mujoco.mj_resetData(model, data)
        data.mocap_pos[scene.furniture] = layout.furniture
        data.mocap_pos[scene.follower], data.mocap_quat[scene.follower] = layout.hand, DOWN
        data.ctrl[:] = -1.0, 1.0
        mujoco.mj_step(model, data, nstep=SETTLING)
        data.qpos[scene.object_qpos] = layout.object
        data.qvel[scene.object_qvel] = 0.0
        # Meta-World leaves out this call, and shows where things stood before.
        mujoco.mj_forward(model, data)
        mujoco.mj_getState(model, data, self.states[row], STATE)
        return True

    def _advance(self, row: int, action: np.ndarray, data: mujoco.MjData) -> bool:
        """Leave the state after one control step in ``data`` and in its row; False if there is none."""
        model, follower = self.scene.model, self.scene.follower
        if not (np.isfinite(action).all() and _healthy(self.states[row])):
            return False
        action = np.clip(action, -1.0, 1.0)
        mujoco.mj_setState(model, data, self.states[row], STATE)
        data.mocap_pos[follower] = np.clip(data.mocap_pos[follower] + action[:3] * ACTION_SCALE, *WORKSPACE)
        data.mocap_quat[follower] = DOWN
        data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(model, data, nstep=SUBSTEPS)
        mujoco.mj_forward(model, data)
        after = np.empty_like(self.states[row])
        mujoco.mj_getState(model, data, after, STATE)
        if not _healthy(after):
            return False
        self.states[row] = after
        return True

    def _look(self, row: int, room: _Room) -> None:
        data, scene, seen = room.data, self.scene, self.observed[row]
        assert data is not None
        right, left = (data.xpos[claw] for claw in scene.claws)
        seen[4:] = seen[:4]
        seen[:3] = data.xpos[scene.hand]
        seen[3] = min(np.linalg.norm(right - left) / WIDEST_GRIP, 1.0)
        self.sites[row] = data.site_xpos[scene.sites]
        room.camera.image(data, self.images[row])


def _healthy(state: np.ndarray) -> bool:
    return bool((np.abs(state) < DIVERGED).all())
