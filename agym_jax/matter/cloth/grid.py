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
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.matter.cloth.kernel import Rows
from agym_jax.matter.shapes import TINY, Xyz, add, dot, map_xyz, scale, sub

CELL = 0.25
"""Size of a cell [m]: btSparseSdf.h."""
FIRST = 2
"""Shapes in the first of two frames."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridShapes:
    """Capsules along z of two frames; a sphere is one of no length.

    The first ``FIRST`` of the k are in the first frame, the others in the second one.
    """

    centre_w: Array  # [m]                                                  (k, 3)
    rot_w: Array  # from the two frames to the world                        (2, 3, 3)
    numbers: Array  # of the distance in a cell, see ``cell_numbers`` [m]   (k, 6)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GridPath:
    """The same in each of s substeps. In the physics the fields are ``Rows`` of one substep."""

    centre: Array  # in its frame, at the substep's end [m]                 (s, 3, k)
    rot: Array  # nine entries, row by row                                  (s, 9, 2)
    moved: Array  # displacement of the centre in the substep [m]           (s, 3, k)
    turned: Array  # change of the rotation's entries                       (s, 9, 2)
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
    matrix = rot[1:].reshape(substeps, 3, 3, 2)
    parts = (centre[1:, :, :FIRST], 0), (centre[1:, :, FIRST:], 1)
    local = [jnp.einsum("sji,sjk->sik", matrix[..., f], c) for c, f in parts]
    numbers = jnp.broadcast_to(end.numbers.T, (substeps, 6, len(end.numbers)))
    return GridPath(
        centre=jnp.concatenate(local, -1), rot=rot[1:], moved=centre[1:] - centre[:-1],
        turned=rot[1:] - rot[:-1], numbers=numbers,
    )  # fmt: skip


def in_frames(pos: Xyz, now: GridPath) -> tuple[Xyz, Xyz]:
    """Vertices in the two frames, from the world's origin [m]."""
    first, second = (_rotated(now.rot, f, pos, (0, 1, 2), 3) for f in (0, 1))
    return first, second


def distance(frames: tuple[Xyz, Xyz], now: GridPath, k: int) -> Array:
    """How far vertices are from shape k by Bullet's account [m] (n,)."""
    local = sub(frames[0 if k < FIRST else 1], _vectors(now.centre, k))
    x, y, z = map_xyz(_in_cell, local)
    p, q, r = _by_height(now.numbers, k, z)
    return p + q * (x + y) + r * x * y


def surface(frames: tuple[Xyz, Xyz], now: GridPath, k: Array) -> tuple[Xyz, Xyz]:
    """Normal, and displacement of the surface in the substep [m], each (n,), of one shape for each vertex."""
    choose = partial(jnp.where, k < FIRST)
    local = sub(map_xyz(choose, *frames), _vectors(now.centre, k))
    x, y, z = map_xyz(_in_cell, local)
    _, q, r = _by_height(now.numbers, k, z)
    slopes = [now.numbers[row, k] for row in (1, 3, 5)]
    across = q + r * y, q + r * x, slopes[0] + slopes[1] * (x + y) + slopes[2] * x * y
    outwards = map_xyz(lambda at, a: jnp.where(at < 0.0, -a, a), local, across)
    out, turned = (
        map_xyz(choose, *(_rotated(rows, f, v, (0, 3, 6), 1) for f in (0, 1)))
        for rows, v in ((now.rot, outwards), (now.turned, local))
    )
    size = jax.lax.rsqrt(jnp.maximum(dot(out, out), TINY))
    return scale(size, out), add(_vectors(now.moved, k), turned)


def _rotated(rows: Rows, f: int, v: Xyz, starts: tuple[int, int, int], step: int) -> Xyz:
    """Matrix f of nine entries in rows, times a vector: by its rows (starts 0, 3, 6; step 1) or its columns (0, 1, 2; 3)."""
    x, y, z = (tuple(rows[i + step * j, f] for j in range(3)) for i in starts)
    return _product(x, v), _product(y, v), _product(z, v)


def _product(a: tuple[Array, ...], v: Xyz) -> Array:
    """Product of three numbers with a vector (n,)."""
    return a[0] * v[0] + a[1] * v[1] + a[2] * v[2]


def _in_cell(local: Array) -> Array:
    """Place in the cell, 0..1."""
    return jnp.minimum(jnp.abs(local) * (1.0 / CELL), 1.0)


def _by_height(numbers: Rows, k: int | Array, z: Array) -> tuple[Array, Array, Array]:
    p, q, r = (numbers[row, k] + numbers[row + 1, k] * z for row in (0, 2, 4))
    return p, q, r


def _vectors(rows: Rows, k: int | Array) -> Xyz:
    return rows[0, k], rows[1, k], rows[2, k]
