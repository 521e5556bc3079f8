from __future__ import annotations

import mujoco
import numpy as np
import pytest

from plp_lightning.envs.maze.rollout import BatchedPhysics
from plp_lightning.envs.maze.walker_model import Box, walker_mjcf

WALL = Box(1.2, 0.0, 0.5, 0.5)


def model(legs: int = 4) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(walker_mjcf(legs, [WALL]))


def roll(physics: BatchedPhysics, controls: np.ndarray) -> np.ndarray:
    """All states ``(T, n, S)`` under ``controls (T, n, U)``."""
    states, seen = physics.initial_states(controls.shape[1]), []
    for control in controls:
        states, valid = physics.step(states, control)
        assert valid.all()
        seen.append(states)
    return np.stack(seen)


@pytest.mark.parametrize("legs", [4, 6])
def test_equals_mj_step_to_the_last_bit(legs):
    walker = model(legs)
    controls = np.random.default_rng(0).uniform(-1, 1, (40, 11, walker.nu))
    physics = BatchedPhysics(walker, frame_skip=5, threads=2)
    states = roll(physics, controls)
    for episode in (0, 10):
        data = mujoco.MjData(walker)
        for control, state in zip(controls[:, episode], states[:, episode], strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(walker, data, 5)
            np.testing.assert_array_equal(state[physics.qpos], data.qpos)
            np.testing.assert_array_equal(state[physics.qvel], data.qvel)


def test_number_order_and_threads_change_no_bit():
    controls = np.random.default_rng(0).uniform(-1, 1, (60, 20, 8))
    together = roll(BatchedPhysics(model(), frame_skip=5, threads=3), controls)
    order = np.random.default_rng(1).permutation(20)
    shuffled = roll(BatchedPhysics(model(), frame_skip=5, threads=1), controls[:, order])
    alone = roll(BatchedPhysics(model(), frame_skip=5), controls[:, [7]])
    np.testing.assert_array_equal(together[:, order], shuffled)
    np.testing.assert_array_equal(together[:, [7]], alone)


def test_spoilt_rows_stay_where_they_were_and_harm_nobody():
    physics = BatchedPhysics(model(), frame_skip=5)
    states, controls = physics.initial_states(3), np.zeros((3, 8))
    clean, _ = physics.step(states, controls)
    controls[1, 2] = np.nan
    states[2, physics.qvel] = 1e7
    after, valid = physics.step(states, controls)
    assert valid.tolist() == [True, False, False]
    np.testing.assert_array_equal(after[1:], states[1:])
    np.testing.assert_array_equal(after[0], clean[0])


@pytest.mark.parametrize("legs", [4, 6])
def test_walker_has_legs_at_equal_angles(legs):
    walker = mujoco.MjModel.from_xml_string(walker_mjcf(legs))
    data = mujoco.MjData(walker)
    mujoco.mj_forward(walker, data)
    feet = np.array([data.body(f"shin_{i}").xpos[:2] for i in range(1, legs + 1)])
    angles = np.sort(np.arctan2(feet[:, 1], feet[:, 0]))
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / legs)
    np.testing.assert_allclose(np.linalg.norm(feet, axis=1), np.sqrt(0.32))


@pytest.mark.parametrize("legs", [4, 6])
def test_ankles_may_only_bend_down(legs):
    walker = mujoco.MjModel.from_xml_string(walker_mjcf(legs))
    data = mujoco.MjData(walker)
    for i in range(1, legs + 1):
        joint = walker.joint(f"ankle_{i}")
        data.qpos[joint.qposadr] = joint.range.mean()
    mujoco.mj_forward(walker, data)
    for i in range(1, legs + 1):
        shin = data.body(f"shin_{i}")
        assert shin.xipos[2] < shin.xpos[2] - 0.1


def test_four_legs_are_gymnasiums_ant():
    from importlib.resources import files

    reference = mujoco.MjModel.from_xml_path(str(files("gymnasium.envs.mujoco") / "assets" / "ant.xml"))
    ours = mujoco.MjModel.from_xml_string(walker_mjcf(4))
    for name in ("body_mass", "body_pos", "body_inertia", "jnt_axis", "jnt_range", "geom_size", "geom_friction"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(reference, name), err_msg=name)
    np.testing.assert_array_equal(ours.actuator_trnid, reference.actuator_trnid)
    np.testing.assert_array_equal(ours.actuator_gear, reference.actuator_gear)
