from __future__ import annotations

import mujoco
import numpy as np
import pytest

from plp_lightning.envs.maze.walker_model import walker_mjcf


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
