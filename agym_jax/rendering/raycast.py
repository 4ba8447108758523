"""Ray casting: ``mj_multiRay`` with correct bounds, plus spheres and surfaces that are not in the model.

Geometry only: ``agym_jax.rendering.shading`` computes colours and the image.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

OPAQUE, CLEAR, HIDDEN = 0, 1, 5  # geom groups given to a private copy of the model
INVISIBLE_ALPHA = 0.1  # anything with at most this alpha is not drawn
OPAQUE_ALPHA = 0.99  # anything with at most this alpha is translucent
FAR = 1e6  # m
CLUSTER = 24  # triangles tested together: consecutive ones are close to each other


@dataclass(frozen=True)
class Marker:
    """An extra sphere that is drawn but is not in the model: an itch target, a piece of food.

    Args:
        pos: centre in the world, (3,) [m].
        radius: radius [m].
        rgba: colour and alpha, (4,) in 0..1.
    """

    pos: np.ndarray | Sequence[float]
    radius: float
    rgba: np.ndarray | Sequence[float] = (0.9, 0.1, 0.1, 1.0)


@dataclass(frozen=True)
class RayScene:
    """Geometry at one instant. Its rows are the geoms of the model, then the markers, then the surfaces.

    Args:
        model: private copy; bounds are current, and geom groups mean opaque, clear or hidden.
        data: the caller's state.
        alpha: opacity of each row, (n,) in 0..1.
        centers: marker centres, (k, 3) [m].
        radii: marker radii, (k,) [m].
        surfaces: corners of the triangles of each flexible surface, each (t, 3, 3) [m].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    alpha: np.ndarray
    centers: np.ndarray
    radii: np.ndarray
    surfaces: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Hits:
    """First intersections of rays.

    Args:
        row: row of ``RayScene``, -1 for no hit, (n,).
        dist: distance along the ray, ``FAR`` for no hit, (n,) [m].
        normal: unit normal facing the ray's origin, (n, 3).
    """

    row: np.ndarray
    dist: np.ndarray
    normal: np.ndarray


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Euclidean norm of each row, (n,)."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def half_extents(geom_type: np.ndarray, size: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """Half sizes of geoms' bounding boxes, from their current sizes instead of the compiled ones.

    Args:
        geom_type: mjtGeom, (n,).
        size: geom_size, (n, 3) [m].
        stored: half sizes from the compiler, kept for meshes and other types, (n, 3) [m].

    Returns:
        (n, 3) [m].
    """
    kind, radius, half = mujoco.mjtGeom, size[:, :1], size[:, 1:2]
    rules = {
        kind.mjGEOM_PLANE: np.full_like(size, FAR),
        kind.mjGEOM_SPHERE: np.repeat(radius, 3, axis=1),
        kind.mjGEOM_CAPSULE: np.hstack([radius, radius, half + radius]),
        kind.mjGEOM_CYLINDER: np.hstack([radius, radius, half]),
        kind.mjGEOM_ELLIPSOID: size,
        kind.mjGEOM_BOX: size,
    }
    return np.select([(geom_type == k)[:, None] for k in rules], list(rules.values()), stored)


def refresh_bounds(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Recompute the culling bounds of ``mj_multiRay`` from the sizes in ``model``.

    The compiled bounds are stale once ``geom_size`` was written. In addition, ``mj_multiRay`` adds
    a body's box centre, which is in the body's frame, to a world position without rotating it,
    and so misses some rays near rotated bodies. A bounding sphere about the body's centre of mass avoids both.

    Args:
        model: private copy, written: geom_aabb, geom_rbound, bvh_aabb.
        data: current kinematics.
    """
    half = half_extents(model.geom_type, model.geom_size, model.geom_aabb[:, 3:])
    plain = model.geom_dataid < 0
    model.geom_aabb[plain, :3] = 0.0
    model.geom_aabb[:, 3:] = half
    radius = np.linalg.norm(np.abs(model.geom_aabb[:, :3]) + half, axis=1)
    model.geom_rbound[:] = radius
    owner = model.geom_bodyid
    extent = np.zeros(model.nbody)
    offset = np.linalg.norm(data.geom_xpos - data.xipos[owner], axis=1)
    np.maximum.at(extent, owner, offset + radius)
    root = model.body_bvhadr
    has = root >= 0
    model.bvh_aabb[root[has], :3] = 0.0
    model.bvh_aabb[root[has], 3:] = extent[has, None]


def build_ray_scene(
    model: mujoco.MjModel, data: mujoco.MjData, alpha: np.ndarray, markers: Sequence[Marker]
) -> RayScene:
    """Build the scene of one instant; nothing is kept between calls.

    Args:
        model: the caller's model, not written.
        data: current kinematics.
        alpha: opacity of each geom, 0 for those that are not drawn, (ngeom,) in 0..1.
        markers: extra spheres.

    Returns:
        The scene.
    """
    private = copy.copy(model)
    private.geom_group[:] = np.where(alpha > OPAQUE_ALPHA, OPAQUE, CLEAR)
    private.geom_group[alpha <= INVISIBLE_ALPHA] = HIDDEN
    refresh_bounds(private, data)
    centers = np.array([m.pos for m in markers], dtype=float).reshape(-1, 3)
    radii = np.array([m.radius for m in markers], dtype=float)
    alpha = np.concatenate([alpha, [m.rgba[3] for m in markers], model.flex_rgba[:, 3]])
    return RayScene(private, data, alpha, centers, radii, surface_triangles(model, data))


def surface_triangles(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, ...]:
    """Corners of the triangles of each flexible surface, world, each (t, 3, 3) [m]."""
    found = []
    for i in range(model.nflex):
        start, count = model.flex_elemdataadr[i], model.flex_elemnum[i]
        elements = model.flex_elem[start : start + 3 * count].reshape(-1, 3)
        found.append(data.flexvert_xpos[model.flex_vertadr[i] + elements])
    return tuple(found)


def intersect_triangles(
    corners: np.ndarray, origin: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First intersection of each ray with triangles, from either side.

    Args:
        corners: (t, 3, 3) [m].
        origin: of all rays, (3,) [m].
        rays: unit directions, (n, 3).

    Returns:
        distance, ``FAR`` for no hit (n,) [m], and unit normal (n, 3).
    """
    dist, normal = np.full(len(rays), FAR), np.zeros((len(rays), 3))
    for some in np.array_split(corners - origin, 1 + len(corners) // CLUSTER):
        a, b, c = np.moveaxis(some, 1, 0)
        towards = np.concatenate([a, b, c])
        towards /= np.maximum(lengths(towards), 1e-12)[:, None]
        middle = towards.mean(0) / max(np.linalg.norm(towards.mean(0)), 1e-12)
        cone = (towards @ middle).min() - 1e-6
        near = np.flatnonzero(rays @ middle >= cone)
        across = np.cross(b - a, c - a)
        across /= np.maximum(lengths(across), 1e-12)[:, None]
        turns = np.stack([rays[near] @ np.cross(u, v).T for u, v in ((a, b), (b, c), (c, a))])
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.einsum("ij,ij->i", across, a) / (rays[near] @ across.T)
        inside = (turns > 0).all(0) | (turns < 0).all(0)
        far = np.where(inside & (far > 0), far, FAR)
        first = far.argmin(1)
        far = far[np.arange(len(near)), first]
        closer = far < dist[near]
        dist[near[closer]], normal[near[closer]] = far[closer], across[first[closer]]
    return dist, normal


def trace(scene: RayScene, origin: np.ndarray, rays: np.ndarray, clear: bool) -> Hits:
    """First intersection of each ray.

    Args:
        scene: the geometry.
        origin: of all rays, (3,) [m].
        rays: unit directions, (n, 3).
        clear: whether translucent geometry counts.

    Returns:
        The hits.
    """
    n = len(rays)
    hit, dist, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    groups = np.array([1, clear, 0, 0, 0, 0], np.uint8)
    mujoco.mj_multiRay(
        scene.model, scene.data, origin, np.ascontiguousarray(rays).ravel(), groups, True, -1,
        hit, dist, normal.reshape(-1), n, FAR,
    )  # fmt: skip
    dist[hit < 0] = FAR
    unseen = INVISIBLE_ALPHA if clear else OPAQUE_ALPHA
    first = scene.model.ngeom
    for row, (center, radius) in enumerate(zip(scene.centers, scene.radii, strict=True), first):
        if scene.alpha[row] <= unseen:
            continue
        to = center - origin
        along = rays @ to
        inside = radius**2 - to @ to + along**2
        near = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), -1.0)
        closer = (near > 0) & (near < dist)
        hit[closer], dist[closer] = row, near[closer]
        normal[closer] = (rays[closer] * near[closer, None] - to) / radius
    for row, corners in enumerate(scene.surfaces, first + len(scene.radii)):
        if scene.alpha[row] <= unseen:
            continue
        near, facing = intersect_triangles(corners, origin, rays)
        closer = near < dist
        hit[closer], dist[closer], normal[closer] = row, near[closer], facing[closer]
    away = np.einsum("ij,ij->i", normal, rays) > 0
    normal[away] *= -1
    return Hits(hit, dist, normal)


def camera_rays(
    view: mujoco.MjvScene, x: np.ndarray, y: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Position and rays of MuJoCo's camera.

    Args:
        view: updated scene; its two cameras (stereo eyes) are averaged.
        x: pixel columns, (n,); 0.5 is the centre of the first.
        y: pixel rows from the top, (n,).
        width: image width in pixels.
        height: image height in pixels.

    Returns:
        position of the eye (3,) [m] and unit directions (n, 3).
    """
    left, right = view.camera[0], view.camera[1]
    eye = (np.asarray(left.pos, dtype=float) + right.pos) / 2
    forward = np.asarray(left.forward, dtype=float)
    up = np.asarray(left.up, dtype=float)
    top, bottom, near = left.frustum_top, left.frustum_bottom, left.frustum_near
    wide = left.frustum_width or 0.5 * width / height * (top - bottom)
    middle = (left.frustum_center + right.frustum_center) / 2
    u = (middle + wide * (2 * x / width - 1)) / near
    v = (top + (bottom - top) * y / height) / near
    rays = forward + u[:, None] * np.cross(forward, up) + v[:, None] * up
    return eye, rays / lengths(rays)[:, None]
