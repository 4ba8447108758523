"""Limbs as cloth meets them in Assistive Gym: by distances that are known on a grid of 0.25 m and interpolated.

Bullet asks a "sparse SDF" how far a vertex is from a shape: exact distances at the corners of cells of 0.25 m in the shape's own
frame (btSparseSdf.h, ``voxelsz``), linear in between. A limb is thinner than a cell. So it has its radius along its frame's
axes, is thinner in between (a rhombus, whose corners are as far from the axis as the limb's surface), and tapers from its middle
to its ends, where the distance from the limb's own axis is positive: 29 to 35 mm at the ends of a forearm. Of the 40 mm that
Bullet keeps cloth off a surface 5 to 11 mm are left there, and spheres at wrist and elbow.

The shapes are symmetric, so that one octant of the eight cells around the centre describes them all, by six numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.matter.cloth.kernel import Rows
from agym_jax.matter.shapes import TINY, Xyz, add, dot, map_xyz, scale, sub

CELL = 0.25
"""Size of a cell [m]: btSparseSdf.h."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridShapes:
    """k capsules along z of their frames; a sphere is one of no length."""

    centre_w: Array  # [m]                                                  (k, 3)
    rot_w: Array  # from their frames to the world                          (k, 3, 3)
    numbers: Array  # of the distance in a cell, see ``cell_numbers`` [m]   (k, 6)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridPath:
    """The same in each of s substeps. In the physics the fields are ``Rows`` of one substep."""

    centre: Array  # at the substep's end, world [m]                        (s, 3, k)
    rot: Array  # nine entries, row by row                                  (s, 9, k)
    moved: Array  # displacement of the centre in the substep [m]           (s, 3, k)
    turned: Array  # change of the rotation's entries                       (s, 9, k)
    numbers: Array  # [m]                                                   (s, 6, k)


def cell_numbers(radius: Array, length: Array) -> Array:
    """Numbers (..., 6) of the distance from capsules in a cell: p + q (x + y) + r x y, each a + b z, with x, y, z in 0..1.

    Args:
        radius: [m] (...).
        length: between the centres of the caps [m] (...).
    """
    beyond = jnp.maximum(CELL - length / 2.0, 0.0)  # of the cap's centre, at the cell's far end

    def corner(across: float, along: Array | float) -> Array:
        return jnp.sqrt(across**2 + along**2) - radius

    near, far = ([corner(CELL * side**0.5, z) for side in (0, 1, 2)] for z in (0.0, beyond))
    rows = [(x[0], x[1] - x[0], x[0] - 2.0 * x[1] + x[2]) for x in (near, far)]
    return jnp.stack([x for a, b in zip(*rows, strict=True) for x in (a, b - a)], -1)


def grid_path(substeps: int, start: GridShapes, end: GridShapes) -> GridPath:
    """Straight lines, divided into substeps."""
    share = jnp.arange(substeps + 1)[:, None, None] / substeps

    def between(a: Array, b: Array) -> Array:
        a, b = (x.reshape(len(x), -1).T for x in (a, b))
        return a + share * (b - a)

    centre, rot = between(start.centre_w, end.centre_w), between(start.rot_w, end.rot_w)
    numbers = jnp.broadcast_to(end.numbers.T, (substeps, 6, len(end.numbers)))
    return GridPath(
        centre=centre[1:], rot=rot[1:], moved=centre[1:] - centre[:-1], turned=rot[1:] - rot[:-1],
        numbers=numbers,
    )  # fmt: skip


def distance(pos: Xyz, now: GridPath, k: int | Array) -> Array:
    """How far vertices are from shape k by Bullet's account [m] (n,)."""
    x, y, z = map_xyz(_in_cell, _local(pos, now, k))
    p, q, r = _by_height(now.numbers, k, z)
    return p + q * (x + y) + r * x * y


def surface(pos: Xyz, now: GridPath, k: Array) -> tuple[Array, Xyz, Xyz]:
    """Distance [m], normal, and displacement of the surface in the substep [m], each (n,), of one shape for each vertex."""
    local = _local(pos, now, k)
    x, y, z = map_xyz(_in_cell, local)
    p, q, r = _by_height(now.numbers, k, z)
    slopes = [now.numbers[row, k] for row in (1, 3, 5)]
    across = q + r * y, q + r * x, slopes[0] + slopes[1] * (x + y) + slopes[2] * x * y
    outwards = map_xyz(lambda at, a: jnp.where(at < 0.0, -a, a), local, across)
    normal = _turn(now.rot, k, outwards)
    size = jax.lax.rsqrt(jnp.maximum(dot(normal, normal), TINY))
    moved = add(_vectors(now.moved, k), _turn(now.turned, k, local))
    return p + q * (x + y) + r * x * y, scale(size, normal), moved


def _local(pos: Xyz, now: GridPath, k: int | Array) -> Xyz:
    """In the shape's frame [m]."""
    off, rot = sub(pos, _vectors(now.centre, k)), now.rot
    x, y, z = ((rot[i, k], rot[3 + i, k], rot[6 + i, k]) for i in range(3))
    return dot(x, off), dot(y, off), dot(z, off)


def _in_cell(local: Array) -> Array:
    """Place in the cell, 0..1."""
    return jnp.minimum(jnp.abs(local) * (1.0 / CELL), 1.0)


def _by_height(numbers: Rows, k: int | Array, z: Array) -> tuple[Array, Array, Array]:
    p, q, r = (numbers[row, k] + numbers[row + 1, k] * z for row in (0, 2, 4))
    return p, q, r


def _turn(rot: Rows, k: int | Array, v: Xyz) -> Xyz:
    """A matrix in rows of nine, times a vector."""
    x, y, z = ((rot[i, k], rot[i + 1, k], rot[i + 2, k]) for i in (0, 3, 6))
    return dot(x, v), dot(y, v), dot(z, v)


def _vectors(rows: Rows, k: int | Array) -> Xyz:
    return rows[0, k], rows[1, k], rows[2, k]
