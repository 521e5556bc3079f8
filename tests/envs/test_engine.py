"""The engine against MuJoCo's own loop, and its promises: purity, one rule for what diverges, all threads at work."""

from __future__ import annotations

import threading

import mujoco
import numpy as np
import pytest

from plp_lightning.envs.engine import Engine
from plp_lightning.envs.maze.physics import MazePhysics
from plp_lightning.envs.maze.walker_model import Box, walker_mjcf
from plp_lightning.envs.native import DIVERGED, Desk

WALL = Box(1.2, 0.0, 0.5, 0.5)
SUBSTEPS = 5


def engine(legs: int = 4, threads: int = 0) -> MazePhysics:
    return MazePhysics(walker_mjcf(legs, [WALL]), threads)


def roll(walkers: MazePhysics, controls: np.ndarray) -> np.ndarray:
    """All states ``(T, n, S)`` under ``controls (T, n, U)``."""
    walkers.begin(controls.shape[1])
    seen = []
    for control in controls:
        assert walkers.hold(np.arange(controls.shape[1]), control, SUBSTEPS).all()
        seen.append(walkers.states.copy())
    return np.stack(seen)


@pytest.mark.parametrize("legs", [4, 6])
def test_equals_mj_step_to_the_last_bit(legs: int) -> None:
    walkers = engine(legs, threads=2)
    controls = np.random.default_rng(0).uniform(-1, 1, (40, 11, walkers.model.nu))
    states = roll(walkers, controls)
    for episode in (0, 10):
        data = mujoco.MjData(walkers.model)
        for control, state in zip(controls[:, episode], states[:, episode], strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(walkers.model, data, SUBSTEPS)
            np.testing.assert_array_equal(state[walkers.qpos], data.qpos)
            np.testing.assert_array_equal(state[walkers.qvel], data.qvel)


def test_number_order_and_threads_change_no_bit() -> None:
    controls = np.random.default_rng(0).uniform(-1, 1, (60, 20, 8))
    together = roll(engine(threads=3), controls)
    order = np.random.default_rng(1).permutation(20)
    shuffled = roll(engine(threads=1), controls[:, order])
    alone = roll(engine(), controls[:, [7]])
    np.testing.assert_array_equal(together[:, order], shuffled)
    np.testing.assert_array_equal(together[:, [7]], alone)


def test_some_rows_in_any_order_and_none_at_all() -> None:
    controls = np.random.default_rng(0).uniform(-1, 1, (5, 8))
    together, apart = engine(), engine()
    for walkers in (together, apart):
        walkers.begin(5)
    together.hold(np.arange(5), controls, SUBSTEPS)
    for rows in ([4, 1], [], [0], [3, 2]):
        assert apart.hold(np.array(rows, dtype=int), controls[rows], SUBSTEPS).tolist() == [True] * len(rows)
    np.testing.assert_array_equal(apart.states, together.states)


def test_spoilt_rows_stay_where_they_were_and_harm_nobody() -> None:
    walkers, rows, controls = engine(), np.arange(3), np.zeros((3, 8))
    walkers.begin(3)
    walkers.hold(rows, controls, SUBSTEPS)
    clean = walkers.states.copy()
    walkers.begin(3)
    controls[1, 2] = np.nan
    walkers.states[2, walkers.qvel] = 10 * DIVERGED
    before = walkers.states.copy()
    assert walkers.hold(rows, controls, SUBSTEPS).tolist() == [True, False, False]
    np.testing.assert_array_equal(walkers.states[1:], before[1:])
    np.testing.assert_array_equal(walkers.states[0], clean[0])


def test_a_row_that_diverges_within_a_step_keeps_its_last_valid_state() -> None:
    walkers = engine()
    walkers.begin(2)
    walkers.states[1, walkers.qvel] = 0.9 * DIVERGED
    before = walkers.states.copy()
    assert walkers.hold(np.arange(2), np.zeros((2, 8)), SUBSTEPS).tolist() == [True, False]
    np.testing.assert_array_equal(walkers.states[1], before[1])
    assert not np.array_equal(walkers.states[0], before[0])


def test_columns_are_where_mujoco_puts_them() -> None:
    walkers, data = engine(), None
    walkers.begin(1)
    data = mujoco.MjData(walkers.model)
    np.testing.assert_array_equal(walkers.states[0, walkers.qpos], data.qpos)
    controls = np.linspace(-1, 1, 8)[None]
    walkers.hold(np.array([0]), controls, SUBSTEPS)
    np.testing.assert_array_equal(walkers.states[:, walkers.columns(mujoco.mjtState.mjSTATE_CTRL)], controls)


def test_threads_work_at_once_each_in_a_room_of_its_own() -> None:
    meeting = threading.Barrier(3, timeout=30)
    rooms: list[int] = []

    class Bare(Engine[mujoco.MjData]):
        def room(self, data: mujoco.MjData) -> mujoco.MjData:
            return data

    def work(room: mujoco.MjData, part: slice) -> None:
        meeting.wait()  # it lets nobody pass unless three are here
        rooms.append(id(room))

    model = mujoco.MjModel.from_xml_string(walker_mjcf(4))
    shared = Bare(model, threads=3)
    shared.share(3, work)
    assert len({*rooms}) == 3
    shared.share(3, work)
    assert len({*rooms}) == 3, "rooms are made once"


def test_what_goes_wrong_in_a_thread_is_heard() -> None:
    def work(desk: Desk, part: slice) -> None:
        raise RuntimeError("no camera")

    with pytest.raises(RuntimeError, match="no camera"):
        engine(threads=2).share(5, work)
