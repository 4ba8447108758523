"""Cloth: extended position-based dynamics of one garment in one world, in plain JAX beside MJX.

A physics step is cut into short substeps, each with one sweep ("small steps": for the same work stiffer than
many sweeps of long steps). In a substep vertices fall freely; bending springs and tethers to the anchors act;
the edges are relaxed colour by colour, each wholly; at last vertices are put outside the nearest solid, with Coulomb
friction. Velocities follow from positions, so collisions are inelastic, and the impulses of the last part are
exactly what the solids feel: impulse over time is the force [N].

Anchors are where the gripper carries them; they pull and feel nothing. Tethers are limits: no vertex is farther
from its nearest anchor than the way along the cloth. They carry the weight of what hangs, which single sweeps
would take long to hand up to the gripper.

DEVIATION(no-self-contact): cloth does not touch itself, as AG's does not. Bending keeps the sleeve open.
DEVIATION(gripper-feels-nothing): anchors do not push back on the robot: the gown weighs 80 g.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax import rsqrt

from agym_jax.matter.shapes import (
    TINY,
    Boxes,
    Capsules,
    Touching,
    Xyz,
    add,
    columns,
    dot,
    length,
    no_boxes,
    scale,
    sub,
)
from agym_jax.matter.weave import ClothSpec, Pairs

HEALING = 0.2
"""Share of an old overlap with a solid that heals in a substep: by displacement, without speed or force."""
RELAXED = 1.0
"""Bound on the share of a vertex's bending errors that one substep undoes; above 4/3 they could grow."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cloth:
    """State of n vertices."""

    pos_w: Array  # [m]                                                     (n, 3)
    vel_w: Array  # [m/s]                                                   (n, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Solids:
    """What cloth can touch: k capsules, then b boxes."""

    person: Capsules  # limbs, torso, and links of the robot if they matter
    furniture: Boxes  # at rest

    @staticmethod
    def of(person: Capsules) -> Solids:
        """Capsules alone."""
        return Solids(person, no_boxes())


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Touch:
    """What k capsules, then b boxes, felt on average over a physics step."""

    net_w: Array  # force of the cloth, world [N]                           (k + b, 3)
    total: Array  # sum of the sizes of the forces of all vertices [N]      (k + b,)
    broken: Array  # the cloth went non-finite and was put back             () bool


def initial(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Cloth:
    """The garment at rest, held at a point.

    Args:
        spec: of the cloth.
        pos_w: of the origin of the garment's frame, world [m] (3,).
        rot_w: of that frame (3, 3); upright, pulled along world y, if left out.
    """
    at_rest = jnp.asarray(spec.garment.vertices, jnp.float32)
    turned = at_rest if rot_w is None else at_rest @ rot_w.T
    return Cloth(pos_w=pos_w + turned, vel_w=jnp.zeros_like(at_rest))


def anchor_positions(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Array:
    """Where the anchors of a garment are that is held at a point, world [m] (a, 3).

    Args:
        spec: of the cloth.
        pos_w: of the origin of the garment's frame, world [m] (3,).
        rot_w: of that frame (3, 3); upright if left out, as AG's, whose anchors never turn.
    """
    return initial(spec, pos_w, rot_w).pos_w[spec.garment.anchors]


def step(
    spec: ClothSpec, cloth: Cloth, start: Solids, end: Solids, anchors_start: Array, anchors_end: Array, dt: float
) -> tuple[Cloth, Touch]:  # fmt: skip
    """Advance by one physics step, while solids and anchors move along straight lines.

    Args:
        spec: of the cloth.
        cloth: n vertices.
        start: solids at its beginning.
        end: at its end.
        anchors_start: where the anchors are at its beginning, world [m] (a, 3).
        anchors_end: at its end.
        dt: its length [s].

    Returns:
        cloth, and what the solids felt.
    """
    fabric = spec.fabric
    h = dt / fabric.substeps
    relax = _relaxation(spec, h)
    n_solids = len(end.person.radius) + len(end.furniture.half)
    mass = jnp.asarray(spec.mass, jnp.float32)

    def between(a: Array, b: Array, share: Array) -> Array:
        return a + share * (b - a)

    def capsules(share: Array) -> Capsules:
        a_w = between(start.person.a_w, end.person.a_w, share)
        return Capsules(a_w, between(start.person.b_w, end.person.b_w, share), end.person.radius)

    def substep(carry: tuple, share: Array) -> tuple[tuple, None]:
        pos, vel, net, total = carry
        anchors = columns(between(anchors_start, anchors_end, share))
        fallen = _fall(spec, pos, vel, h)
        moved = relax(_hold(spec, fallen, anchors), anchors)
        then, now = capsules(share - 1.0 / fabric.substeps), capsules(share)
        solids = Touching.join((now.touching(moved, then), end.furniture.touching(moved)))
        push, heal, nearest = _push_out(spec, moved, pos, solids)
        after = add(moved, push)
        vel = scale((1.0 - fabric.damping * h) / h, sub(after, pos))
        after = add(after, heal)
        impulse = scale(-mass / h, push)  # on the solids
        felt = jnp.where(nearest, jnp.stack(impulse)[:, None], 0.0).sum(-1)
        sizes = jnp.where(nearest, mass / h * jnp.sqrt(dot(push, push)), 0.0).sum(-1)
        return (after, vel, net + felt, total + sizes), None

    shares = jnp.arange(1, fabric.substeps + 1) / fabric.substeps
    none = jnp.zeros((3, n_solids)), jnp.zeros(n_solids)
    carry = (columns(cloth.pos_w), columns(cloth.vel_w), *none)
    (pos, vel, net, total), _ = jax.lax.scan(substep, carry, shares)
    moved = Cloth(pos_w=jnp.stack(pos, -1), vel_w=jnp.stack(vel, -1))
    broken = ~(jnp.isfinite(moved.pos_w).all() & jnp.isfinite(moved.vel_w).all())
    kept = Cloth(_finite(cloth.pos_w), jnp.zeros_like(cloth.vel_w))
    cloth = jax.tree.map(lambda a, b: jnp.where(broken, a, b), kept, moved)
    net, total = (jnp.where(broken, 0.0, x) / dt for x in (net.T, total))
    return cloth, Touch(net_w=net, total=total, broken=broken)


def _finite(x: Array) -> Array:
    return jnp.where(jnp.isfinite(x), x, 0.0)


def _fall(spec: ClothSpec, pos: Xyz, vel: Xyz, h: float) -> Xyz:
    """Where free vertices would be after h [s]."""
    vel = (vel[0], vel[1], vel[2] + spec.fabric.gravity * h)
    return add(pos, scale(h * jnp.minimum(1.0, spec.fabric.max_speed / length(vel)), vel))


def _hold(spec: ClothSpec, pos: Xyz, anchors: Xyz) -> Xyz:
    """Anchored vertices where the gripper has them."""
    held = spec.held >= 0
    return tuple(jnp.where(held, a[spec.held], x) for x, a in zip(pos, anchors, strict=True))


def _relaxation(spec: ClothSpec, h: float):
    """A function of positions and anchors: one sweep over hinges, tethers and edges."""
    inverse = np.where(spec.held >= 0, 0.0, 1.0 / spec.mass)
    hinge, edge = (_shares(p, inverse, h) for p in (spec.hinges, spec.edges))
    crowd = np.maximum(hinge.sum(0), 1e-9) / RELAXED
    crowd = np.maximum(crowd, crowd[spec.hinges.partner])  # the same for both of a pair: momentum stays
    hinge = hinge / np.maximum(crowd, 1.0)
    free = spec.held < 0
    rows = range(len(edge))

    def relax(pos: Xyz, anchors: Xyz) -> Xyz:
        bent = [_pull(spec.hinges, hinge, row, pos) for row in range(len(hinge))]
        for shift in bent:
            pos = add(pos, shift)
        off = sub(pos, tuple(a[spec.tether] for a in anchors))
        inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
        excess = free * jnp.maximum(1.0 - jnp.asarray(spec.reach, jnp.float32) * inverse_length, 0.0)
        pos = sub(pos, scale(excess, off))
        for row in rows:
            pos = add(pos, _pull(spec.edges, edge, row, pos))
        return pos

    return relax


def _shares(pairs: Pairs, inverse: np.ndarray, h: float) -> np.ndarray:
    """Share of a pair's error that its first vertex undoes in a substep (r, n)."""
    both = inverse + inverse[pairs.partner] + pairs.compliance / h**2
    return pairs.active * inverse / np.maximum(both, 1e-12)


def _pull(pairs: Pairs, share: np.ndarray, row: int, pos: Xyz) -> Xyz:
    """How one row of pairs moves every vertex [m], each (n,)."""
    partner = pairs.partner[row]
    off = sub(tuple(x[partner] for x in pos), pos)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    rest = jnp.asarray(pairs.rest[row], jnp.float32)
    return scale(jnp.asarray(share[row], jnp.float32) * (1.0 - rest * inverse_length), off)


def _push_out(spec: ClothSpec, pos: Xyz, start: Xyz, solids: Touching) -> tuple[Xyz, Xyz, Array]:
    """How vertices are pushed out of the nearest solid, and healed besides, and which solid that is (k, n).

    A push undoes what moved inwards within the substep, and up to friction * push of what slid along the solid.
    What was inside before is healed by displacement.
    """
    count = len(solids.dist)
    if not count:
        still = scale(jnp.float32(0.0), pos)
        return still, still, jnp.zeros(solids.dist.shape, bool)
    nearest = jnp.arange(count)[:, None] == jnp.argmin(solids.dist, axis=0)

    def of_nearest(x: Array) -> Array:
        return jnp.where(nearest, x, 0.0).sum(0)

    normal = tuple(map(of_nearest, solids.normal))
    went = sub(sub(pos, start), tuple(map(of_nearest, solids.moved)))
    inwards = dot(went, normal)
    free = jnp.asarray(spec.held < 0, jnp.float32)
    overlap = free * jnp.maximum(spec.fabric.thickness - of_nearest(solids.dist), 0.0)
    depth = jnp.minimum(overlap, jnp.maximum(-inwards, 0.0))
    slid = sub(went, scale(inwards, normal))
    undo = jnp.minimum(1.0, spec.fabric.friction * depth * rsqrt(jnp.maximum(dot(slid, slid), TINY)))
    push = sub(scale(depth, normal), scale(undo, slid))
    return push, scale(HEALING * (overlap - depth), normal), nearest
