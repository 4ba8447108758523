"""Distances of points from the solids they may touch: capsules of the person, boxes of the furniture, the floor.

Signed distances (negative inside) and outward normals between n points and k solids, in world coordinates.
Square roots are guarded, so that values and gradients are finite everywhere.

A set of vectors is a tuple of three arrays of coordinates, ``Xyz``: an axis of length 3 is slow on every
processor. Arrays between k solids and n points are (k, n).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.math3d import TINY, rotation_rows, unit_quat_parts

Xyz = tuple[Array, Array, Array]
"""Coordinates x, y and z of vectors."""
Quat = tuple[Array, Array, Array, Array]
"""Parts w, x, y and z of quaternions."""
Ends = tuple[Xyz, Xyz]
"""The two ends of capsules."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Distances:
    """Distances of n points from k solids."""

    dist: Array  # signed, from the surface [m]                             (k, n)
    normal: Xyz  # outward unit vector                                      each (k, n)
    moved: Xyz  # displacement of the solid's nearest point [m]             each (k, n)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Capsules:
    """Segments with a radius; a sphere is a segment of length zero."""

    a_w: Array  # one end [m]                                               (k, 3)
    b_w: Array  # the other [m]                                             (k, 3)
    radius: Array  # [m]                                                    (k,)

    def ends(self) -> Ends:
        """The two ends, by coordinates."""
        return columns(self.a_w), columns(self.b_w)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Boxes:
    """Boxes at rest."""

    pos_w: Array  # centres [m]                                             (k, 3)
    quat_w: Array  # wxyz                                                   (k, 4)
    half: Array  # half sizes [m]                                           (k, 3)

    def columns(self) -> tuple[Xyz, Quat, Xyz]:
        """Centres, quaternions and half sizes, by coordinates."""
        return columns(self.pos_w), quat_columns(self.quat_w), columns(self.half)


def capsule_distances(points_w: Xyz, now: Ends, then: Ends, radius: Array) -> Distances:
    """Distances of n points from k capsules.

    Args:
        points_w: [m], each (n,).
        now: ends of the capsules [m], each (k,).
        then: where the ends were before they moved [m], each (k,).
        radius: [m] (k,).
    """
    (a, b), (a_then, b_then) = (tuple(map(_to_column, ends)) for ends in (now, then))
    axis = sub(b, a)
    from_a = sub(points_w, a)
    share = jnp.clip(dot(from_a, axis) / jnp.maximum(dot(axis, axis), TINY), 0.0, 1.0)
    off = sub(from_a, scale(share, axis))
    gap = length(off)
    moved_a, moved_b = sub(a, a_then), sub(b, b_then)
    return Distances(
        dist=gap - radius[:, None],
        normal=scale(1.0 / gap, off),
        moved=add(moved_a, scale(share, sub(moved_b, moved_a))),
    )


def box_distances(points_w: Xyz, pos_w: Xyz, quat_w: Quat, half: Xyz) -> Distances:
    """Distances of n points from k boxes at rest: exact outside, from the nearest face inside.

    Args:
        points_w: [m], each (n,).
        pos_w: centres [m], each (k,).
        quat_w: orientations wxyz, each (k,).
        half: half sizes [m], each (k,).
    """
    rot = [_to_column(row) for row in rotation_rows(*unit_quat_parts(*quat_w))]
    local, half = matvec_transposed(rot, sub(points_w, _to_column(pos_w))), _to_column(half)
    excess = map_xyz(lambda x, h: jnp.abs(x) - h, local, half)
    outside = map_xyz(lambda e: jnp.maximum(e, 0.0), excess)
    deepest = jnp.maximum(jnp.maximum(excess[0], excess[1]), excess[2])
    gap, is_out = length(outside), deepest > 0
    face = map_xyz(lambda e: (e == deepest).astype(gap.dtype), excess)
    face = scale(1.0 / (face[0] + face[1] + face[2]), face)
    towards = map_xyz(
        lambda x, o, f: jnp.sign(x) * jnp.where(is_out, o / gap, f), local, outside, face
    )
    zero = jnp.zeros_like(gap)
    return Distances(
        dist=jnp.where(is_out, gap, deepest),
        normal=matvec(rot, towards),
        moved=(zero, zero, zero),
    )


def floor_distances(points_w: Xyz, height: Array) -> Distances:
    """Distances of points, each (n,), from a level floor at a height [m] ().

    The floor is one solid: arrays are (1, n).
    """
    dist = (points_w[2] - height)[None]
    zero = jnp.zeros_like(dist)
    return Distances(dist=dist, normal=(zero, zero, zero + 1.0), moved=(zero, zero, zero))


def no_capsules() -> Capsules:
    """An empty set of capsules."""
    return Capsules(jnp.zeros((0, 3)), jnp.zeros((0, 3)), jnp.zeros(0))


def no_boxes() -> Boxes:
    """An empty set of boxes."""
    return Boxes(jnp.zeros((0, 3)), jnp.zeros((0, 4)), jnp.zeros((0, 3)))


def columns(points: Array) -> Xyz:
    """Coordinates of points (..., 3), each (...)."""
    return points[..., 0], points[..., 1], points[..., 2]


def quat_columns(quat: Array) -> Quat:
    """Parts w, x, y and z of quaternions (..., 4), each (...)."""
    return quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]


def _to_column(a: Xyz) -> Xyz:
    """Coordinates of k solids, (k,) -> (k, 1), to be broadcast against points (n,)."""
    return map_xyz(lambda x: x[:, None], a)


def map_xyz(function: Callable[..., Array], *vectors: Xyz) -> Xyz:
    """Apply a function to the x, the y and the z coordinates."""
    x, y, z = zip(*vectors, strict=True)
    return function(*x), function(*y), function(*z)


def dot(a: Xyz, b: Xyz) -> Array:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: Xyz) -> Array:
    """Euclidean length, differentiable at zero."""
    return jnp.sqrt(jnp.maximum(dot(a, a), TINY))


def add(a: Xyz, b: Xyz) -> Xyz:
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def sub(a: Xyz, b: Xyz) -> Xyz:
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(factor: Array | float, a: Xyz) -> Xyz:
    """Product of a scalar and a vector."""
    return factor * a[0], factor * a[1], factor * a[2]


def matvec(rows: Sequence[Xyz], a: Xyz) -> Xyz:
    """Product of matrices, given by their three rows, and vectors."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def matvec_transposed(rows: Sequence[Xyz], a: Xyz) -> Xyz:
    """Product of the transposes of matrices, given by their three rows, and vectors."""
    x, y, z = rows
    return matvec(((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])), a)
