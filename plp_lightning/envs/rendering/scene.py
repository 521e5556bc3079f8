"""Lighten a scene for a renderer on the processor: fewer triangles, and nothing drawn that no one sees.

What moves and collides stays as it is: the lightened model's motion equals the shipped model's, bit for bit.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

MOST_FACES = 600  # a mesh with more triangles is decimated
CELL = 0.02  # edge of the grid cells in which a mesh's vertices are merged, m: about a pixel in an image of 64 × 64
LEAST_VERTICES = 4  # of a mesh that MuJoCo compiles: those of a tetrahedron
HIDDEN = 5  # a group that is not drawn


def lighten(spec: mujoco.MjSpec, unseen: Collection[str], image_size: int) -> mujoco.MjModel:
    """Compile a model that is drawn fast, without the bodies ``unseen``, up to images ``(size, size, 3)``."""
    shipped = spec.compile()
    large = [shipped.mesh(i).name for i in range(shipped.nmesh) if shipped.mesh_facenum[i] > MOST_FACES]
    heavy = {name for name in large if _add_light_mesh(spec, shipped, name)}
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.meshname in heavy:
            _draw_light(geom)
    model = spec.compile()
    _hide(model, heavy, unseen)
    model.vis.quality.offsamples = 0
    model.vis.global_.offwidth = model.vis.global_.offheight = image_size
    return model


def decimate(vertices: np.ndarray, faces: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge all vertices in a cell of a grid into their mean, and drop the triangles that collapse.

    See Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes" (1993).

    Args:
        vertices: ``(V, 3)``, m.
        faces: ``(F, 3)`` rows of ``vertices``.
        cell: Edge of a cell, m.

    Returns:
        Fewer vertices ``(V', 3)`` and faces ``(F', 3)``.
    """
    _, merged = np.unique(np.floor(vertices / cell), axis=0, return_inverse=True)
    merged = merged.reshape(-1)
    sums = np.stack([np.bincount(merged, column) for column in vertices.T], axis=1)
    corners = merged[faces]
    alive = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(corners[alive], axis=1), axis=0, return_index=True)
    return sums / np.bincount(merged)[:, None], corners[alive][np.sort(first)]


def _add_light_mesh(spec: mujoco.MjSpec, shipped: mujoco.MjModel, name: str) -> bool:
    """Add a decimated twin of a mesh, unless nothing is left of one so small, as the answer says.

    A mesh that is edited in place keeps its old normals.
    """
    mesh = shipped.mesh(name).id
    vertex, corner = shipped.mesh_vertadr[mesh], shipped.mesh_faceadr[mesh]
    # The compiler moves a mesh into the frame of its inertia; geoms in the spec know the frame of the file.
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, shipped.mesh_quat[mesh])
    turned = shipped.mesh_vert[vertex : vertex + shipped.mesh_vertnum[mesh]].astype(float) @ rotation.reshape(3, 3).T
    faces = shipped.mesh_face[corner : corner + shipped.mesh_facenum[mesh]]
    vertices, faces = decimate(turned + shipped.mesh_pos[mesh], faces, CELL)
    if len(vertices) < LEAST_VERTICES or len(faces) < LEAST_VERTICES:
        return False
    twin = spec.add_mesh(name=f"{name}_light")
    twin.uservert, twin.userface = vertices.ravel().tolist(), faces.astype(np.int32).ravel().tolist()
    twin.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    return True


def _draw_light(geom: mujoco.MjsGeom) -> None:
    """Draw the decimated mesh in place of the heavy one; a geom that collides keeps its own and gets a companion."""
    light = f"{geom.meshname}_light"
    if geom.contype == 0 and geom.conaffinity == 0:
        geom.meshname = light
        return
    same = {name: getattr(geom, name) for name in ("type", "rgba", "group", "material", "pos", "quat")}
    geom.parent.add_geom(meshname=light, contype=0, conaffinity=0, mass=0.0, **same)


def _hide(model: mujoco.MjModel, heavy: Collection[str], unseen: Collection[str]) -> None:
    """Move what is not to be drawn, all sites among it, to a hidden group; in the spec, groups decide inertia too."""
    bodies = {model.body(name).id for name in unseen}
    meshes = {model.mesh(name).id for name in heavy}
    for geom in range(model.ngeom):
        is_mesh = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
        if model.geom_bodyid[geom] in bodies or (is_mesh and model.geom_dataid[geom] in meshes):
            model.geom_group[geom] = HIDDEN
    model.site_group[:] = HIDDEN
