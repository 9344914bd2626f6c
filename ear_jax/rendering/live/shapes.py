"""A robot's shapes as the page draws them: capsules and coarse meshes, each fixed to a body."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

CELL = 0.022  # metres: vertices of a mesh within one cell become one
PLANE, SPHERE, CAPSULE, CYLINDER, BOX, MESH = (
    getattr(mujoco.mjtGeom, f"mjGEOM_{name}").value
    for name in ("PLANE", "SPHERE", "CAPSULE", "CYLINDER", "BOX", "MESH")
)


def shapes(portrait: mujoco.MjModel, model: mujoco.MjModel) -> list[dict[str, Any]]:
    """Lists the visible shapes of a robot and its surroundings, without the floor.

    Args:
      portrait: the model that pictures show.
      model: the model that moves, with the same qpos; bodies that move have the same names in both.

    Returns:
      For each shape its `body` in `model`, 0 if it does not move, its `colour` (red, green, blue, 0 to 255), and in the
      frame of that body, in metres, either `ends` [2, 3] and `radius`, or `vertices` [n, 3] and `faces` [m, 3].
    """
    shown, moving = _posed(portrait), _posed(model)
    turn, shift = between(portrait, model)
    found = []
    for geom in map(int, np.flatnonzero(portrait.geom_group < 3)):
        if portrait.geom_type[geom] == PLANE or portrait.geom_rgba[geom, 3] == 0:
            continue
        root = portrait.body_weldid[portrait.geom_bodyid[geom]]
        body = _counterpart(portrait, model, root) if root else 0
        # From the shape to the world of the portrait, to the world of the model, to the body.
        rotation = turn @ shown.geom_xmat[geom].reshape(3, 3)
        place = turn @ shown.geom_xpos[geom] + shift
        frame = moving.xmat[body].reshape(3, 3)
        rotation, place = frame.T @ rotation, frame.T @ (place - moving.xpos[body])
        shape = _shape(portrait, geom)
        for name in ("ends", "vertices"):
            if name in shape:
                shape[name] = np.round(shape[name] @ rotation.T + place, 4).tolist()
        found.append({"body": int(body), "colour": _colour(portrait, geom), **shape})
    return found


def _counterpart(one: mujoco.MjModel, other: mujoco.MjModel, body: int) -> int:
    """Returns the body of another model of the same robot that is a body of this one."""
    return int(body) if one.nbody == other.nbody else int(other.body(one.body(body).name).id)


def between(portrait: mujoco.MjModel, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rotation [3, 3] and the shift [3] from the portrait's world to the model's."""
    shown, moving = _posed(portrait), _posed(model)
    body = int(model.jnt_bodyid[0])
    there = _counterpart(model, portrait, body)
    turn = moving.xmat[body].reshape(3, 3) @ shown.xmat[there].reshape(3, 3).T
    return turn, moving.xpos[body] - turn @ shown.xpos[there]


def _posed(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def _shape(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind in (CAPSULE, SPHERE):
        half = size[1] if kind == CAPSULE else 0.0
        return {"ends": np.array([[0, 0, -half], [0, 0, half]]), "radius": round(float(size[0]), 4)}
    if kind == MESH:
        return _coarse(*_mesh(model, int(model.geom_dataid[geom])))
    if kind == BOX:
        return _box(size)
    return _round(size, cylinder=kind == CYLINDER)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    return vertices.astype(float), model.mesh_face[face : face + model.mesh_facenum[mesh]]


def _coarse(vertices: np.ndarray, faces: np.ndarray) -> dict[str, Any]:
    """Merges vertices that share a cell of a grid, and leaves out the faces that this makes flat."""
    cells, inverse = np.unique(np.floor(vertices / CELL), axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    merged = np.zeros((len(cells), 3))
    np.add.at(merged, inverse, vertices)
    merged /= np.bincount(inverse)[:, None]
    faces = inverse[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return {"vertices": merged, "faces": faces[np.sort(first)].tolist()}


def _box(size: np.ndarray) -> dict[str, Any]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return {"vertices": corners, "faces": [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]}


def _round(size: np.ndarray, cylinder: bool, around: int = 14) -> dict[str, Any]:
    """Returns a cylinder, or else an ellipsoid, as rings of vertices that are closed at both ends."""
    angle = 2 * np.pi * np.arange(around) / around
    if cylinder:
        rings = [(size[0], size[0], -size[1]), (size[0], size[0], size[1])]
    else:
        lifts = np.linspace(-np.pi / 2, np.pi / 2, 9)[1:-1]
        rings = [(size[0] * np.cos(lift), size[1] * np.cos(lift), size[2] * np.sin(lift)) for lift in lifts]
    ring = [np.column_stack([a * np.cos(angle), b * np.sin(angle), np.full(around, z)]) for a, b, z in rings]
    low, high = (np.array([[0, 0, sign * (size[1] if cylinder else size[2])]]) for sign in (-1, 1))
    faces, last = [], len(rings) * around
    for i in range(around):
        j = (i + 1) % around
        faces += [(last, j, i), (last + 1, last - around + i, last - around + j)]
        for start in range(0, last - around, around):
            a, b, c, d = start + i, start + j, start + around + j, start + around + i
            faces += [(a, b, c), (a, c, d)]
    return {"vertices": np.concatenate([*ring, low, high]), "faces": faces}


def _colour(model: mujoco.MjModel, geom: int) -> list[int]:
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return np.rint(255 * rgba[:3]).astype(int).tolist()
