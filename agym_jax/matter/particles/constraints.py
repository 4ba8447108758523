"""Pushes out of overlaps, in positions, with Coulomb friction: solids, pairs of particles, the vessel's wall.

A push that undoes an overlap by ``d`` also takes back up to ``friction * d`` of what has slid along the
contact since the beginning of the substep: the friction cone, in positions. What is less is taken back
wholly, so a particle that sticks does not creep.
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
from agym_jax.matter.shapes import TINY, Touching, Xyz, add, dot, each, scale, sub

RECOVERY = 0.05
"""Speed at which shallow overlaps heal [m/s]: slow enough not to be seen, or felt as a bounce."""
HEALING = 0.5
"""Share of a deep overlap that heals in a substep: a heap that was hit hard opens again."""
EAGER, CALM = 4.0, 2.0
"""In a Jacobi sweep a particle with more contacts than this gets the mean of the pushes times this, in all
sweeps of a substep but the last one, and in the last. The eager sweeps overshoot, but carry the weight of a
pile to its bottom; the calm one always shrinks what is left. Measured on 64 settled spheres, two sweeps in
substeps of 2 ms: worst overlap 0.48 mm and mean speed 0.9 mm/s, with calm ones only 0.93 mm and 1.3 mm/s."""


_Crowd = tuple[Xyz, Xyz, Array]
"""Where particles are, where they were, and which share of a push each of them takes."""


def solid_pushes(
    radius: float, friction: float, pos: Xyz, start: Xyz, solids: Touching
) -> tuple[Xyz, Array]:
    """How far k solids push n particles out of them.

    Args:
        radius: of a particle [m].
        friction: coefficient.
        pos: where particles are [m], each (n,).
        start: where they were at the beginning of the substep.
        solids: their distances from them.

    Returns:
        pushes [m], each (k, n), and 1 where a solid touches a particle, else 0 (k, n).
    """
    depth = jnp.maximum(radius - solids.dist, 0.0)
    slid = _tangential(sub(sub(pos, start), solids.moved), solids.normal)
    undo = jnp.minimum(1.0, friction * depth * rsqrt(_square(slid)))
    return sub(scale(depth, solids.normal), scale(undo, slid)), _is_positive(depth)


def push_out(pos: Xyz, groups: Sequence[tuple[Xyz, Array]]) -> Xyz:
    """Push particles out of groups of solids: the mean of the pushes, for a particle that touches several.

    Args:
        pos: where particles are [m], each (n,).
        groups: sums of ``solid_pushes`` over solids, each (n,).
    """
    push = reduce(add, [pushes for pushes, _ in groups])
    count = reduce(jnp.add, [touched for _, touched in groups])
    return add(pos, scale(1.0 / jnp.maximum(count, 1.0), push))


def push_pairs(
    radius: float,
    friction: float,
    local: Xyz,
    old: Xyz,
    contacts: Array,
    crowd: float,
    h: float,
    sum_over: SumOver = sum_rows,
) -> tuple[Xyz, Array]:
    """One Jacobi sweep over all pairs; both of a pair are pushed alike, so momentum stays.

    Args:
        radius: of a particle [m].
        friction: coefficient.
        local: where they are [m], each (n,).
        old: where they were at the beginning of the substep.
        contacts: with others, of each particle in the last sweep (n,).
        crowd: ``EAGER`` or ``CALM``.
        h: length of the substep [s].
        sum_over: how to sum over the others.

    Returns:
        where they are then, and their contacts in this sweep.
    """
    weight = 0.5 * jnp.minimum(1.0, crowd / jnp.maximum(contacts, 1.0))
    shifts = partial(_pair_pushes, radius, friction, h, (local, old, weight))
    pushes, touched = sum_over(shifts, (local, old, weight))
    return add(local, pushes), touched - 1.0


def push_vessel(
    vessel: Vessel, radius: float, friction: float, local: Xyz, old: Xyz, h: float
) -> tuple[Xyz, Array]:
    """Push particles out of the vessel's wall, to the side where they were.

    Args:
        vessel: the shape.
        radius: of a particle [m].
        friction: coefficient.
        local: where particles are in the vessel's frame [m], each (n,).
        old: where they were at the beginning of the substep, in its frame then.
        h: length of the substep [s].

    Returns:
        where they are then, and which touched the wall.
    """
    gap, normal = vessel.wall(*local)
    through = (vessel.holds(*local) != vessel.holds(*old)) & ~vessel.passes(old, local)
    side = jnp.where(through, -1.0, 1.0)
    clear = _apart(radius + vessel.thickness / 2, vessel.wall(*old)[0], h)
    depth = jnp.maximum(clear - side * gap, 0.0)
    local = add(local, scale(side * depth, normal))
    slid = _tangential(sub(local, old), normal)
    undo = jnp.minimum(1.0, friction * depth * rsqrt(_square(slid)))
    return sub(local, scale(undo, slid)), depth > 0


def _pair_pushes(
    radius: float, friction: float, h: float, some: _Crowd, others: _Crowd
) -> tuple[Xyz, Array]:
    """How far each of o others pushes each of s particles, each (o, s), and whether it touches (o, s)."""
    (local, old, weight), (local_of, old_of, weight_of) = some, others
    apart, were = _from_to(local_of, local), _from_to(old_of, old)
    moved = sub(apart, were)
    square, square_then = _square(apart), _square(were)
    inverse = rsqrt(square)
    clear = _apart(2 * radius, square_then * rsqrt(square_then), h)
    # a particle overlaps itself: that push is zero, but it counts as a contact
    depth = jnp.maximum(clear - square * inverse, 0.0)
    along = dot(moved, apart) * inverse * inverse
    slid = jnp.maximum(dot(moved, moved) - along * along * square, TINY)
    both = jnp.minimum(weight[None], weight_of[:, None])
    undo = both * jnp.minimum(1.0, friction * depth * rsqrt(slid))
    push = both * depth * inverse + undo * along
    return sub(scale(push, apart), scale(undo, moved)), _is_positive(depth)


def _from_to(a: Xyz, b: Xyz) -> Xyz:
    """From each of a (first axis) to each of b (second)."""
    return each(lambda x, y: y[None] - x[:, None], a, b)


def _is_positive(x: Array) -> Array:
    """As a number, 1 or 0."""
    return (x > 0).astype(x.dtype)


def _tangential(a: Xyz, normal: Xyz) -> Xyz:
    """Without its part along a unit vector."""
    return sub(a, scale(dot(a, normal), normal))


def _square(a: Xyz) -> Array:
    """Squared length, never zero."""
    return jnp.maximum(dot(a, a), TINY)


def _apart(clear: float, then: Array, h: float) -> Array:
    """Distance to which a substep may push what belongs ``clear`` apart and was ``then`` apart [m]."""
    return jnp.minimum(clear, then + jnp.maximum(RECOVERY * h, HEALING * (clear - then)))
