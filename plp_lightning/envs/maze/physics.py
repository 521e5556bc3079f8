"""Bodies in mazes on the engine: rows of states advance by controls that are held, in compiled code."""

from __future__ import annotations

import mujoco
import numpy as np

from plp_lightning.envs.engine import Engine
from plp_lightning.envs.native import Desk, entry, load, mj_forward, mj_step, save

LEAST = 8  # episodes that a thread takes at a time: a step of one point is shorter than the way into compiled code


class MazePhysics(Engine[Desk]):
    """Steps a body whose controls are held, on so many ``threads``; 0 means one for each core."""

    def __init__(self, mjcf: str, threads: int = 0) -> None:
        super().__init__(mujoco.MjModel.from_xml_string(mjcf), threads, LEAST)
        self.physical = slice(self.qpos.start, self.qvel.stop)

    def room(self, data: mujoco.MjData) -> Desk:
        return Desk.of(self.model, data)

    def hold(self, rows: np.ndarray, controls: np.ndarray, substeps: int, forward: bool = False) -> np.ndarray:
        """Apply controls ``(n, U)`` to rows ``(n,)`` of the states, which change in place, for one control step.

        Args:
            rows: Rows of the states.
            controls: Controls that are held.
            substeps: Physics steps of the control step; with none, time stands still.
            forward: Compute forces with ``mj_forward`` first, as environments do that set the state there; it gives
                the solver another warm start.

        Returns:
            Mask ``(n,)`` of the rows that are valid, see :meth:`Engine.advance`.
        """

        def change(desk: Desk, rows: np.ndarray, controls: np.ndarray, valid: np.ndarray) -> None:
            _hold(desk, self.states, rows, controls, valid, substeps, forward)

        return self.advance(rows, controls, change)


@entry
def _hold(
    desk: Desk,
    states: np.ndarray,
    rows: np.ndarray,
    controls: np.ndarray,
    valid: np.ndarray,
    substeps: int,
    forward: bool,
) -> None:
    for i in range(len(rows)):
        state = states[rows[i]]
        valid[i] = valid[i] and load(desk, state)
        if valid[i]:
            if forward:
                mj_forward(desk.model, desk.data)  # the forces of the last controls, as in the environment
            desk.ctrl[:] = controls[i]
            for _ in range(substeps):
                mj_step(desk.model, desk.data)
            valid[i] = save(desk, state)
