"""Position constraints of particles, with Coulomb friction: solids, pairs of particles, the vessel's wall.

A correction that removes a penetration of depth ``d`` also undoes up to ``friction * d`` of the tangential
displacement since the beginning of the substep: the friction cone, in positions. A smaller displacement is undone
completely, so a particle that sticks does not creep.
Vectors are three arrays of coordinates (``shapes.Xyz``).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce

import jax.numpy as jnp
from jax import Array
from jax.lax import rsqrt

from agym_jax.matter.fused_scan import SumOver, sum_rows
from agym_jax.matter.particles.containers import Vessel
from agym_jax.matter.shapes import TINY, Distances, Xyz, add, dot, map_xyz, scale, sub

RECOVERY_SPEED = 0.05
"""Speed at which shallow penetrations are removed [m/s]: slow enough not to be visible, or to act as a bounce."""
RECOVERY_SHARE = 0.5
"""Share of a deep penetration that is removed in a substep, so that a heap that was compressed recovers."""
RELAXATION, LAST_RELAXATION = 4.0, 2.0
"""Over-relaxation of the Jacobi sweeps of a substep, and of its last one: a particle with more contacts than this
gets the mean of their corrections times this. The first sweeps overshoot, but carry the weight of a pile to its
bottom; the last always reduces what remains. Measured on 64 settled spheres, two sweeps in substeps of 2 ms: worst
penetration 0.48 mm and mean speed 0.9 mm/s; with the smaller factor in both sweeps 0.93 mm and 1.3 mm/s."""


_Spheres = tuple[Xyz, Xyz, Array]
"""Of particles: present and earlier position [m], and the share of a pair's correction that each takes."""


def solid_corrections(
    radius: float, friction: float, pos: Xyz, start: Xyz, solids: Distances
) -> tuple[Xyz, Array]:
    """Corrections that move n particles out of k solids.

    Args:
        radius: of a particle [m].
        friction: coefficient.
        pos: positions of the particles [m], each (n,).
        start: their positions at the beginning of the substep [m], each (n,).
        solids: distances of the particles' centres from the solids.

    Returns:
        corrections [m], each (k, n), and 1 where a solid touches a particle, else 0 (k, n).
    """
    depth = jnp.maximum(radius - solids.dist, 0.0)
    slid = _tangential(sub(sub(pos, start), solids.moved), solids.normal)
    undo = jnp.minimum(1.0, friction * depth * rsqrt(_square(slid)))
    return sub(scale(depth, solids.normal), scale(undo, slid)), _is_positive(depth)


def apply_solids(pos: Xyz, groups: Sequence[tuple[Xyz, Array]]) -> Xyz:
    """Positions [m] after the corrections of groups of solids, averaged where a particle touches several.

    Args:
        pos: positions of the particles [m], each (n,).
        groups: sums of ``solid_corrections`` over the solids of each group, each (n,).
    """
    correction = reduce(add, [corrections for corrections, _ in groups])
    count = reduce(jnp.add, [touched for _, touched in groups])
    return add(pos, scale(1.0 / jnp.maximum(count, 1.0), correction))


def apply_pairs(
    radius: float,
    friction: float,
    local: Xyz,
    old: Xyz,
    contacts: Array,
    relaxation: float,
    h: float,
    sum_over: SumOver = sum_rows,
) -> tuple[Xyz, Array]:
    """One Jacobi sweep over all pairs of particles; opposite corrections conserve momentum.

    Args:
        radius: of a particle [m].
        friction: coefficient.
        local: positions of the particles [m], each (n,).
        old: their positions at the beginning of the substep [m], each (n,).
        contacts: number of contacts of each particle in the sweep before (n,).
        relaxation: ``RELAXATION`` or ``LAST_RELAXATION``.
        h: length of the substep [s].
        sum_over: sums over the other particles.

    Returns:
        positions after the sweep [m], and the number of contacts in it (n,).
    """
    weight = 0.5 * jnp.minimum(1.0, relaxation / jnp.maximum(contacts, 1.0))
    pairs = partial(_pair_corrections, radius, friction, h, (local, old, weight))
    corrections, touched = sum_over(pairs, (local, old, weight))
    return add(local, corrections), touched - 1.0


def apply_vessel(
    vessel: Vessel, radius: float, friction: float, local: Xyz, old: Xyz, h: float
) -> tuple[Xyz, Array]:
    """Move particles out of the vessel's wall, to the side on which they were.

    Args:
        vessel: the shape.
        radius: of a particle [m].
        friction: coefficient.
        local: positions in the vessel's frame [m], each (n,).
        old: positions at the beginning of the substep, in the vessel's frame at that time [m], each (n,).
        h: length of the substep [s].

    Returns:
        positions after the correction [m], and which particles touch the wall (n,) bool.
    """
    gap, normal = vessel.wall(*local)
    through = (vessel.holds(*local) != vessel.holds(*old)) & ~vessel.passes(old, local)
    side = jnp.where(through, -1.0, 1.0)
    clear = _target_distance(radius + vessel.thickness / 2, vessel.wall(*old)[0], h)
    depth = jnp.maximum(clear - side * gap, 0.0)
    local = add(local, scale(side * depth, normal))
    slid = _tangential(sub(local, old), normal)
    undo = jnp.minimum(1.0, friction * depth * rsqrt(_square(slid)))
    return sub(local, scale(undo, slid)), depth > 0


def _pair_corrections(
    radius: float, friction: float, h: float, some: _Spheres, others: _Spheres
) -> tuple[Xyz, Array]:
    """Correction of each of s particles by each of o others [m], each (o, s), and 1 where they touch (o, s)."""
    (local, old, weight), (local_of, old_of, weight_of) = some, others
    apart, were = _from_to(local_of, local), _from_to(old_of, old)
    moved = sub(apart, were)
    square, square_then = _square(apart), _square(were)
    inverse = rsqrt(square)
    clear = _target_distance(2 * radius, square_then * rsqrt(square_then), h)
    # a particle overlaps itself: that correction is zero, but it counts as a contact
    depth = jnp.maximum(clear - square * inverse, 0.0)
    along = dot(moved, apart) * inverse * inverse
    slid = jnp.maximum(dot(moved, moved) - along * along * square, TINY)
    both = jnp.minimum(weight[None], weight_of[:, None])
    undo = both * jnp.minimum(1.0, friction * depth * rsqrt(slid))
    along_normal = both * depth * inverse + undo * along
    return sub(scale(along_normal, apart), scale(undo, moved)), _is_positive(depth)


def _from_to(a: Xyz, b: Xyz) -> Xyz:
    """Vectors from each of a (first axis) to each of b (second)."""
    return map_xyz(lambda x, y: y[None] - x[:, None], a, b)


def _is_positive(x: Array) -> Array:
    """1 where x is positive, else 0."""
    return (x > 0).astype(x.dtype)


def _tangential(a: Xyz, normal: Xyz) -> Xyz:
    """The component perpendicular to a unit vector."""
    return sub(a, scale(dot(a, normal), normal))


def _square(a: Xyz) -> Array:
    """Squared length, bounded away from zero."""
    return jnp.maximum(dot(a, a), TINY)


def _target_distance(clear: float, then: Array, h: float) -> Array:
    """Distance to which a substep may separate what was ``then`` apart and does not touch at ``clear`` [m]."""
    return jnp.minimum(
        clear, then + jnp.maximum(RECOVERY_SPEED * h, RECOVERY_SHARE * (clear - then))
    )
