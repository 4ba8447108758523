"""Solids that particles touch: capsules of the person, boxes of the furniture, the floor.

Signed distances (negative inside) and outward normals of n points to k solids, in world coordinates.
Square roots are guarded, so values and gradients are finite everywhere.

A set of vectors is a tuple of three arrays of coordinates, ``Xyz``: an axis of length 3 is slow on every
processor. Between k solids and n points arrays are (k, n).
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
"""Both ends of capsules."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Touching:
    """Where n points are with respect to k solids."""

    dist: Array  # signed, from the surface [m]                             (k, n)
    normal: Xyz  # outward unit vector                                      each (k, n)
    moved: Xyz  # how far the solid's nearest material moved [m]            each (k, n)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Capsules:
    """Segments with a radius; a sphere is a segment of length zero."""

    a_w: Array  # one end [m]                                               (k, 3)
    b_w: Array  # the other [m]                                             (k, 3)
    radius: Array  # [m]                                                    (k,)

    def ends(self) -> Ends:
        """Both ends, in columns."""
        return columns(self.a_w), columns(self.b_w)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Boxes:
    """Boxes that do not move."""

    pos_w: Array  # centres [m]                                             (k, 3)
    quat_w: Array  # wxyz                                                   (k, 4)
    half: Array  # half sizes [m]                                           (k, 3)

    def columns(self) -> tuple[Xyz, Quat, Xyz]:
        """Centres, quaternions and half sizes, in columns."""
        return columns(self.pos_w), quat_columns(self.quat_w), columns(self.half)


def capsules_touching(points_w: Xyz, now: Ends, then: Ends, radius: Array) -> Touching:
    """Distances of points, each (n,), from k capsules: ends [m] as they are and as they were, radii [m]."""
    (a, b), (a_then, b_then) = (tuple(map(_upright, ends)) for ends in (now, then))
    axis = sub(b, a)
    from_a = sub(points_w, a)
    share = jnp.clip(dot(from_a, axis) / jnp.maximum(dot(axis, axis), TINY), 0.0, 1.0)
    off = sub(from_a, scale(share, axis))
    gap = length(off)
    moved_a, moved_b = sub(a, a_then), sub(b, b_then)
    return Touching(
        dist=gap - radius[:, None],
        normal=scale(1.0 / gap, off),
        moved=add(moved_a, scale(share, sub(moved_b, moved_a))),
    )


def boxes_touching(points_w: Xyz, pos_w: Xyz, quat_w: Quat, half: Xyz) -> Touching:
    """Distances of points, each (n,), from k boxes, in columns: exact outside, from the nearest face inside."""
    rot = [_upright(row) for row in rotation_rows(*unit_quat_parts(*quat_w))]
    local, half = turn_back(rot, sub(points_w, _upright(pos_w))), _upright(half)
    excess = each(lambda x, h: jnp.abs(x) - h, local, half)
    outside = each(lambda e: jnp.maximum(e, 0.0), excess)
    deepest = jnp.maximum(jnp.maximum(excess[0], excess[1]), excess[2])
    gap, is_out = length(outside), deepest > 0
    face = each(lambda e: (e == deepest).astype(gap.dtype), excess)
    face = scale(1.0 / (face[0] + face[1] + face[2]), face)
    towards = each(
        lambda x, o, f: jnp.sign(x) * jnp.where(is_out, o / gap, f), local, outside, face
    )
    still = jnp.zeros_like(gap)
    return Touching(
        dist=jnp.where(is_out, gap, deepest),
        normal=turn(rot, towards),
        moved=(still, still, still),
    )


def floor_touching(points_w: Xyz, height: Array) -> Touching:
    """Distances of points, each (n,), from a level floor at a height [m] (): one solid."""
    dist = (points_w[2] - height)[None]
    none = jnp.zeros_like(dist)
    return Touching(dist=dist, normal=(none, none, none + 1.0), moved=(none, none, none))


def no_capsules() -> Capsules:
    """Nobody is there."""
    return Capsules(jnp.zeros((0, 3)), jnp.zeros((0, 3)), jnp.zeros(0))


def no_boxes() -> Boxes:
    """No furniture."""
    return Boxes(jnp.zeros((0, 3)), jnp.zeros((0, 4)), jnp.zeros((0, 3)))


def columns(points: Array) -> Xyz:
    """Coordinates of points (..., 3), each (...)."""
    return points[..., 0], points[..., 1], points[..., 2]


def quat_columns(quat: Array) -> Quat:
    """Parts w, x, y and z of quaternions (..., 4), each (...)."""
    return quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]


def _upright(a: Xyz) -> Xyz:
    """Of k solids, each (k,) -> (k, 1), against points (n,)."""
    return each(lambda x: x[:, None], a)


def each(function: Callable[..., Array], *vectors: Xyz) -> Xyz:
    """A function of coordinates, for x, y and z."""
    x, y, z = zip(*vectors, strict=True)
    return function(*x), function(*y), function(*z)


def dot(a: Xyz, b: Xyz) -> Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: Xyz) -> Array:
    """Euclidean length, differentiable at zero."""
    return jnp.sqrt(jnp.maximum(dot(a, a), TINY))


def add(a: Xyz, b: Xyz) -> Xyz:
    """The sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def sub(a: Xyz, b: Xyz) -> Xyz:
    """The difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(factor: Array | float, a: Xyz) -> Xyz:
    """A multiple."""
    return factor * a[0], factor * a[1], factor * a[2]


def turn(rows: Sequence[Xyz], a: Xyz) -> Xyz:
    """Vectors turned by rotation matrices, given by their three rows."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def turn_back(rows: Sequence[Xyz], a: Xyz) -> Xyz:
    """Vectors turned by the inverses of rotation matrices, given by their three rows."""
    x, y, z = rows
    return turn(((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])), a)
