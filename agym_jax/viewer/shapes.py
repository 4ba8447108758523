"""The geoms of MuJoCo models as scaled copies of five unit meshes.

A browser draws thousands of copies of one mesh at once, and a person of another size is the same copies at other scales.
A capsule is a tube and two balls, so that its caps stay round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from agym_jax.rendering.mesh_models import FIRST_HIDDEN_GROUP

GEOM = mujoco.mjtGeom
FINE, COARSE = 20, 12
"""Sides of what is round: of a few people, and of many."""
UNITS = ("ball", "box", "tube", "rod")


@dataclass(frozen=True)
class Mesh:
    """Triangles."""

    vertices: np.ndarray  # float32                                            (n, 3)
    faces: np.ndarray  # uint32                                                (m, 3)


@dataclass(frozen=True)
class Copies:
    """Copies of one mesh that geoms of a model are made of.

    Attributes:
        geoms: to which each belongs (n,).
        offsets: of each along its geom's z axis [m] (n,).
        scales: (n, 3).
        colours: red, green, blue from 0 to 255 (n, 3).
        opacities: (n,).
    """

    geoms: np.ndarray
    offsets: np.ndarray
    scales: np.ndarray
    colours: np.ndarray
    opacities: np.ndarray


@cache
def unit(name: str, sides: int = FINE) -> Mesh:
    """One of ``UNITS``: of radius or half length 1; a tube is open, a rod closed."""
    if name == "box":
        return _box()
    if name == "ball":
        angles = _turn(sides // 2, np.pi)
        return _surface(np.sin(angles), -np.cos(angles), sides)
    if name == "tube":
        return _surface(np.ones(2), np.array([-1.0, 1.0]), sides)
    # a rod: its rims are there twice, so that their edges are sharp
    radii, heights = np.array([0.0, 1, 1, 1, 1, 0]), np.array([-1.0, -1, -1, 1, 1, 1])
    return _surface(radii, heights, sides)


def _turn(parts: int, angle: float) -> np.ndarray:
    return np.linspace(0.0, angle, parts + 1)


def _surface(radii: np.ndarray, heights: np.ndarray, sides: int) -> Mesh:
    """A surface of revolution about z; two equal points in a row are an edge."""
    turn = _turn(sides, 2 * np.pi)[:-1]
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices = np.concatenate(
        [
            np.column_stack([r * ring, np.full(sides, z)])
            for r, z in zip(radii, heights, strict=True)
        ]
    )
    here, faces = np.arange(sides), []
    for i in range(len(radii) - 1):
        if radii[i] == radii[i + 1] and heights[i] == heights[i + 1]:
            continue
        low, high, beside = i * sides + here, (i + 1) * sides + here, np.roll(here, -1) - here
        if radii[i] > 1e-9:
            faces.append(np.stack([low, low + beside, high + beside], axis=1))
        if radii[i + 1] > 1e-9:
            faces.append(np.stack([low, high + beside, high], axis=1))
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.uint32))


def _box() -> Mesh:
    """Six sides with corners of their own, so that edges are sharp."""
    square = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    vertices, faces = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            side = np.empty((4, 3))
            side[:, axis] = sign
            side[:, [(axis + 1) % 3, (axis + 2) % 3]] = square if sign > 0 else square[:, ::-1]
            faces += [np.array([[0, 1, 2], [0, 2, 3]]) + 4 * len(vertices)]
            vertices.append(side)
    return Mesh(
        np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.uint32)
    )


def mesh_of(model: mujoco.MjModel, key: str, sides: int = FINE) -> Mesh:
    """The mesh that copies are of: one of ``UNITS``, or the number of a mesh of the model."""
    if key in UNITS:
        return unit(key, sides)
    mesh = int(key)
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    return Mesh(
        model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]].astype(np.float32),
        model.mesh_face[face : face + model.mesh_facenum[mesh]].astype(np.uint32),
    )


def drawn_geoms(model: mujoco.MjModel, moving: bool) -> list[int]:
    """Ids of the geoms to draw: those that move with a joint, or the others; without the floor."""
    welded = model.body_weldid[model.geom_bodyid] == 0
    plane = model.geom_type == int(GEOM.mjGEOM_PLANE)
    shown = (model.geom_group < FIRST_HIDDEN_GROUP) & ~plane & (welded != moving)
    return np.flatnonzero(shown).tolist()


def copies_of(model: mujoco.MjModel, geoms: Sequence[int]) -> dict[str, Copies]:
    """The copies of each mesh that geoms of a model are made of."""
    found: dict[str, list[tuple[int, float, np.ndarray]]] = {}
    for geom in geoms:
        for key, offset, scale in _parts(model, geom):
            found.setdefault(key, []).append((geom, offset, scale))
    made = {}
    for key, rows in found.items():
        ids = np.array([row[0] for row in rows])
        rgba = np.where(
            model.geom_matid[ids, None] >= 0, model.mat_rgba[model.geom_matid[ids]], model.geom_rgba[ids]
        ) if model.nmat else model.geom_rgba[ids]  # fmt: skip
        made[key] = Copies(
            ids,
            np.array([row[1] for row in rows]),
            np.array([row[2] for row in rows], np.float32),
            np.round(255 * rgba[:, :3]).astype(np.uint8),
            rgba[:, 3].astype(np.float32),
        )
    return made


def _parts(model: mujoco.MjModel, geom: int) -> list[tuple[str, float, np.ndarray]]:
    """What a geom is made of: key, offset along z [m], scale (3,)."""
    kind, size = GEOM(model.geom_type[geom]), model.geom_size[geom]
    across = np.array([size[0], size[0], size[0]])
    if kind == GEOM.mjGEOM_SPHERE:
        return [("ball", 0.0, across)]
    if kind == GEOM.mjGEOM_ELLIPSOID:
        return [("ball", 0.0, size)]
    if kind == GEOM.mjGEOM_BOX:
        return [("box", 0.0, size)]
    along = np.array([size[0], size[0], size[1]])
    if kind == GEOM.mjGEOM_CYLINDER:
        return [("rod", 0.0, along)]
    if kind == GEOM.mjGEOM_CAPSULE:
        return [("tube", 0.0, along), ("ball", size[1], across), ("ball", -size[1], across)]
    if kind == GEOM.mjGEOM_MESH:
        return [(str(model.geom_dataid[geom]), 0.0, np.ones(3))]
    return []  # no scene here has height fields
