"""The nearest solid of each vertex of the cloth: capsules that move, of which some may be found as AG's cloth does, the robot's links, and the floor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.lax import rsqrt

from agym_jax.matter.cloth.grid import MARGIN, Grid, interpolated
from agym_jax.matter.cloth.kernel import Rows
from agym_jax.matter.cloth.robot_links import Layout, Links, read_off
from agym_jax.matter.shapes import TINY, Capsules, Xyz, add, dot, length, map_xyz, scale, sub


@dataclass(frozen=True)
class Solids:
    """What is known of the solids when a program is compiled."""

    count: int  # of capsules
    gridded: tuple[int, ...]  # those that may be found by a grid
    thickness: float  # of the cloth, which stays so far away [m]
    floor: float | None  # its height [m]; None: there is none
    shapes: tuple[Layout, ...] = ()  # of the robot


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trajectory:
    """Anchors and solids in each of s substeps. In the physics the fields are ``Rows`` of one substep."""

    anchors: Array  # positions at the substep's end, world [m]             (s, 3, a)
    a: Array  # one end of each capsule at the substep's end, world [m]     (s, 3, k)
    axis: Array  # from there to the other end [m]                          (s, 3, k)
    moved: Array  # displacement of the one end in the substep [m]          (s, 3, k)
    turned: Array  # displacement of the other end, relative to that [m]    (s, 3, k)
    inverse: Array  # 1 / squared length [1/m^2]                            (s, 1, k)
    radius: Array  # [m]                                                    (s, 1, k)
    grid: Array | None  # axes x, y and z of its grid, world                (s, 9, k)
    on: Array | None  # whether it is found by the grid, 0 or 1             (s, 1, k)
    frames: Array | None  # of r shapes of the robot at the substep's end   (s, 12, r)
    shifts: Array | None  # by how much these change in the substep         (s, 12, r)
    meets: Array | None  # whether the cloth meets the robot, 0 or 1        (s, 1, 1)
    distances: Array | None  # ``LinkGrids.distances`` [m]                  (s, 1, m)


def trajectory(
    substeps: int, start: Capsules, end: Capsules, anchors_start: Array, anchors_end: Array, grid: Grid | None,
    links: Links | None = None,
) -> Trajectory:  # fmt: skip
    """Straight lines, divided into substeps; see ``solver.step``. The axes of the capsules' grids stay as they are."""
    share = jnp.arange(substeps + 1)[:, None, None] / substeps

    def between(a: Array, b: Array) -> Array:
        return a.T + share * (b - a).T

    def always(rows: Array) -> Array:
        return jnp.broadcast_to(rows, (substeps, *rows.shape))

    a, b = between(start.a_w, end.a_w), between(start.b_w, end.b_w)
    axis, count = b - a, len(end.radius)
    squared = jnp.maximum(jnp.sum(axis**2, 1, keepdims=True), TINY)
    axes = on = None
    if grid is not None:
        axes = always(jnp.transpose(grid.rot_w, (2, 1, 0)).reshape(9, count))
        some = jnp.array([[k in grid.which for k in range(count)]])
        on = always(jnp.where(some, grid.on, 0.0))
    frames = shifts = meets = distances = None
    if links is not None:
        way = between(links.start, links.end)
        frames, shifts = way[1:], way[1:] - way[:-1]
        meets = always(jnp.reshape(links.meets, (1, 1)))
        distances = always(jnp.asarray(links.grids.distances)[None])
    return Trajectory(
        anchors=between(anchors_start, anchors_end)[1:],
        a=a[1:],
        axis=axis[1:],
        moved=a[1:] - a[:-1],
        turned=axis[1:] - axis[:-1],
        inverse=1.0 / squared[1:],
        radius=always(end.radius[None]),
        grid=axes,
        on=on,
        frames=frames,
        shifts=shifts,
        meets=meets,
        distances=distances,
    )


def vectors(rows: Rows, at: int | Array, first: int = 0) -> Xyz:
    """Return vectors at some columns of three rows, x, y and z."""
    return rows[first, at], rows[first + 1, at], rows[first + 2, at]


def nearest(pos: Xyz, now: Trajectory, solids: Solids) -> tuple[Array, Array, Xyz, Xyz]:
    """Nearest solid of each vertex: index, distance [m], normal, displacement of its surface [m]; each (n,).

    The floor's index is the number of capsules, the robot's shapes follow.
    """
    zero = scale(jnp.float32(0.0), pos)
    which, dist = jnp.full_like(pos[0], solids.count, jnp.int32), jnp.full_like(pos[0], jnp.inf)
    normal = carried = zero
    if solids.count:
        which, dist, normal, carried = _nearest_capsule(pos, now, solids)
    for k, layout in enumerate(solids.shapes):
        found = _link(pos, now, solids, k, layout)
        nearer = (found[1] < dist) | jnp.isnan(found[1])
        which, dist, normal, carried = jax.tree.map(
            partial(jnp.where, nearer), found, (which, dist, normal, carried)
        )
    if solids.floor is not None:
        above = pos[2] - solids.floor
        lower = above < dist
        which, dist = jnp.where(lower, solids.count, which), jnp.minimum(above, dist)
        x, y, z = (jnp.where(lower, 0.0, n) for n in normal)
        normal = x, y, jnp.where(lower, 1.0, z)
        carried = map_xyz(lambda c: jnp.where(lower, 0.0, c), carried)
    return which, dist, normal, carried


def _nearest_capsule(pos: Xyz, now: Trajectory, solids: Solids) -> tuple[Array, Array, Xyz, Xyz]:
    """``nearest`` among capsules. Only distances are computed for all; the rest again for the nearest one."""

    def offset(k: int | Array) -> tuple[Array, Xyz]:
        """Nearest point of a capsule's axis, in 0..1 from end a, and the vector from there [m]."""
        from_a, axis = sub(pos, vectors(now.a, k)), vectors(now.axis, k)
        share = jnp.clip(dot(from_a, axis) * now.inverse[0, k], 0.0, 1.0)
        return share, sub(from_a, scale(share, axis))

    def surface(k: int | Array, off: Xyz, gridded: bool) -> tuple[Array, Xyz]:
        """Distance from a capsule [m], and the normal there."""
        gap = length(off)
        dist, normal = gap - now.radius[0, k], scale(1.0 / gap, off)
        if gridded and now.on is not None:
            there, steepest, known = _by_grid(pos, now, k)
            there = there - now.radius[0, k] - (MARGIN - solids.thickness)
            known = known & (now.on[0, k] > 0.5)
            dist = jnp.where(known, there, dist)
            x, y, z = (jnp.where(known, a, b) for a, b in zip(steepest, normal, strict=True))
            normal = x, y, z
        return dist, normal

    which, least = jnp.zeros_like(pos[0], jnp.int32), jnp.full_like(pos[0], jnp.inf)
    for k in range(solids.count):
        dist, _ = surface(k, offset(k)[1], k in solids.gridded)
        # a solid that is not finite makes the cloth non-finite
        nearer = (dist < least) | jnp.isnan(dist)
        which, least = jnp.where(nearer, k, which), jnp.minimum(dist, least)
    share, off = offset(which)
    dist, normal = surface(which, off, bool(solids.gridded))
    carried = add(vectors(now.moved, which), scale(share, vectors(now.turned, which)))
    return which, dist, normal, carried


def _link(
    pos: Xyz, now: Trajectory, solids: Solids, k: int, layout: Layout
) -> tuple[Array, Array, Xyz, Xyz]:
    """``nearest`` for one shape of the robot."""
    assert now.frames is not None
    assert now.shifts is not None
    assert now.meets is not None
    assert now.distances is not None
    off = sub(pos, vectors(now.frames, k))
    axes, turned = (
        [vectors(rows, k, first) for first in (3, 6, 9)] for rows in (now.frames, now.shifts)
    )
    x, y, z = (dot(off, axis) for axis in axes)
    dist, slopes, known = read_off((x, y, z), now.distances, layout)
    met = now.meets[0, 0] > 0.5
    away = jnp.where(met & jnp.isnan(x + y + z), jnp.nan, jnp.inf)  # as of capsules
    dist = jnp.where(met & known, dist - (MARGIN - solids.thickness), away)
    steepest = scale(rsqrt(jnp.maximum(dot(slopes, slopes), TINY)), slopes)
    carried = add(_along(turned, (x, y, z)), vectors(now.shifts, k))
    which = jnp.full_like(pos[0], solids.count + 1 + k, jnp.int32)
    return which, dist, _along(axes, steepest), carried


def _along(axes: list[Xyz], local: Xyz) -> Xyz:
    """Vectors that are given by their components along three axes, in the frame of the axes."""
    x, y, z = (scale(part, axis) for part, axis in zip(local, axes, strict=True))
    return add(add(x, y), z)


def _by_grid(pos: Xyz, now: Trajectory, k: int | Array) -> tuple[Array, Xyz, Array]:
    """``grid.interpolated`` of vertices, with a direction in world axes."""
    assert now.grid is not None
    axes = [vectors(now.grid, k, 3 * i) for i in range(3)]
    off = sub(pos, add(vectors(now.a, k), scale(jnp.float32(0.5), vectors(now.axis, k))))
    x, y, z = (dot(off, axis) for axis in axes)
    half = 0.5 * rsqrt(now.inverse[0, k])
    dist, steepest, known = interpolated((x, y, z), half)
    return dist, _along(axes, steepest), known
