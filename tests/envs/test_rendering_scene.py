"""A lightened scene: fewer triangles, the same motion."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from plp_lightning.envs.rendering.scene import HIDDEN, MOST_FACES, decimate, lighten
from plp_lightning.envs.tabletop.model import REACH_FILE, UNSEEN, WINDOW_FILE, read_scene

SQUARE = np.array([[0.1, 0.1, 0.0], [0.3, 0.2, 0.0], [2.5, 0.5, 0.0], [2.5, 2.5, 0.0], [0.5, 2.5, 0.0]])
FACES = np.array([[0, 2, 3], [1, 3, 4], [0, 1, 2]])


def test_vertices_of_a_cell_become_their_mean() -> None:
    vertices, faces = decimate(SQUARE, FACES, cell=1.0)
    corners = {tuple(np.round(vertices[corner], 6)) for corner in faces.ravel()}
    assert corners == {(0.2, 0.15, 0.0), (2.5, 0.5, 0.0), (2.5, 2.5, 0.0), (0.5, 2.5, 0.0)}
    assert len(vertices) == 4
    assert len(faces) == 2  # the third has two corners in one cell


def test_fine_cells_change_nothing_but_the_order() -> None:
    vertices, faces = decimate(SQUARE, FACES, cell=0.01)
    np.testing.assert_allclose(vertices[faces], SQUARE[FACES])


def test_faces_that_become_equal_are_kept_once() -> None:
    doubled = np.concatenate([SQUARE, SQUARE + 0.001])
    vertices, faces = decimate(doubled, np.concatenate([FACES, FACES + 5]), cell=1.0)
    assert (len(vertices), len(faces)) == (4, 2)


@pytest.mark.parametrize("scene", [REACH_FILE, WINDOW_FILE])
def test_motion_is_the_shipped_models_bit_for_bit(scene: str) -> None:
    models = read_scene(scene).compile(), lighten(read_scene(scene), UNSEEN, image_size=64)
    trails = []
    for model in models:
        data, stream = mujoco.MjData(model), np.random.default_rng(0)
        trail, contacts = [], 0
        for _ in range(120):
            data.mocap_pos[0] = stream.uniform([-0.1, 0.55, 0.0], [0.1, 0.75, 0.15])
            data.mocap_quat[0] = [1, 0, 1, 0]
            data.ctrl[:] = stream.uniform(-1, 1, 2)
            mujoco.mj_step(model, data, nstep=5)
            trail.append(np.concatenate([data.qpos, data.qvel]))
            contacts += data.ncon
        assert contacts > 20
        trails.append(np.stack(trail))
    np.testing.assert_array_equal(*trails)


@pytest.mark.parametrize("scene", [REACH_FILE, WINDOW_FILE])
def test_little_is_left_to_draw(scene: str) -> None:
    shipped, light = read_scene(scene).compile(), lighten(read_scene(scene), UNSEEN, image_size=64)
    faces = [sum(model.mesh_facenum[model.geom_dataid[g]] for g in drawn_meshes(model)) for model in (shipped, light)]
    assert faces[1] < faces[0] / 8
    assert len(drawn_meshes(light)) == len(drawn_meshes(shipped))
    assert all(light.mesh_facenum[light.geom_dataid[g]] <= 3 * MOST_FACES for g in drawn_meshes(light))
    assert (light.site_group == HIDDEN).all()
    assert (light.vis.global_.offwidth, light.vis.quality.offsamples) == (64, 0)


def drawn_meshes(model: mujoco.MjModel) -> list[int]:
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    return [int(geom) for geom in np.flatnonzero(is_mesh & (model.geom_group < 3))]
