"""Cloth: extended position-based dynamics of one garment in one world, in plain JAX beside MJX.

A physics step is cut into short substeps, each with one sweep ("small steps": for the same work stiffer than
many sweeps of long steps). In a substep vertices fall freely; bending springs and tethers to the anchors act;
the edges are relaxed colour by colour, each wholly; at last vertices are put outside the nearest solid, with Coulomb
friction. Velocities follow from positions, so collisions are inelastic, and the impulses of the last part are
exactly what the solids feel: impulse over time is the force [N].

Anchors are where the gripper carries them, or behind it where the cloth slides through its fingers (``give_way``):
between two vertices whose edge is stretched to several times its length a limb would come through. Tethers are
limits: no vertex is farther from its nearest anchor than the way along the cloth. They carry the weight of what
hangs, which single sweeps would take long to hand up to the gripper.

Nothing is scattered, and between two gathers everything belongs to one vertex: XLA makes one kernel of each
colour, and the last one does the contacts too.

DEVIATION(no-self-contact): cloth does not touch itself, as AG's does not. Bending keeps the sleeve open.
DEVIATION(grip-slips): a gown that is caught slides through the fingers instead of being pulled through the limb;
when it comes free they gather it in, and when more than 15 cm have slid through it is out of the hand for the rest
of the episode. AG's anchors never give way.
DEVIATION(gripper-feels-nothing): anchors do not push back on the robot: the gown weighs 80 g.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax import rsqrt

from agym_jax.matter.shapes import TINY, Capsules, Xyz, add, columns, dot, each, length, scale, sub
from agym_jax.matter.weave import ClothSpec, Pairs

HEALING = 0.2
"""Share of an old overlap with a solid that heals in a substep: by displacement, without speed or force."""
RELAXED = 1.0
"""Bound on the share of a vertex's bending errors that one substep undoes; above 4/3 they could grow."""
HELD = 1.8
"""Fingers hold cloth until its most stretched edge is so many times as long as at rest."""
SLIDES, GATHERS = 3.0, 0.5
"""How fast cloth slides through fingers, or is gathered in again, for every unit of stretch, one at most, more or less [m/s]."""
LET_GO = 0.15
"""When more than this has slid through the fingers, they hold nothing [m]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cloth:
    """State of n vertices."""

    pos_w: Array  # [m]                                                     (n, 3)
    vel_w: Array  # [m/s]                                                   (n, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Touch:
    """What k capsules and the anchors felt on average over a physics step."""

    net_w: Array  # force of the cloth, world [N]                           (k, 3)
    total: Array  # sum of the sizes of the forces of all vertices [N]      (k,)
    grip_w: Array  # force with which the anchors hold the rest, world [N]  (3,)
    stretch: Array  # greatest length of an edge, over that at rest         ()
    broken: Array  # the cloth went non-finite and was put back             () bool


def initial(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Cloth:
    """The garment as it hangs, or where nobody has let it, as it was cut, held at a point.

    Args:
        spec: of the cloth.
        pos_w: of the origin of the garment's frame, world [m] (3,).
        rot_w: of that frame (3, 3); upright, pulled along world y, if left out.
    """
    g = spec.garment
    at_rest = jnp.asarray(g.vertices if g.hanging is None else g.hanging, jnp.float32)
    turned = at_rest if rot_w is None else at_rest @ rot_w.T
    return Cloth(pos_w=pos_w + turned, vel_w=jnp.zeros_like(at_rest))


def anchor_positions(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Array:
    """Where the anchors of a garment are that is held at a point, world [m] (a, 3).

    Args:
        spec: of the cloth.
        pos_w: of the origin of the garment's frame, world [m] (3,).
        rot_w: of that frame (3, 3); upright if left out.
    """
    local = jnp.asarray(spec.garment.vertices[spec.garment.anchors], jnp.float32)
    return pos_w + (local if rot_w is None else local @ rot_w.T)


def step(
    spec: ClothSpec, cloth: Cloth, start: Capsules, end: Capsules, anchors_start: Array, anchors_end: Array, dt: float,
    held: Array | None = None, floor: float | None = None,
) -> tuple[Cloth, Touch]:  # fmt: skip
    """Advance by one physics step, while solids and anchors move along straight lines.

    Args:
        spec: of the cloth.
        cloth: n vertices.
        start: the k solids at its beginning: limbs, torso, furniture.
        end: at its end.
        anchors_start: where the anchors are at its beginning, world [m] (a, 3).
        anchors_end: at its end.
        dt: its length [s].
        held: whether the anchors hold the cloth, () bool; they do if left out.
        floor: height of the floor [m]; there is none if left out.

    Returns:
        cloth, and what the solids felt. A vertex counts for the solid that it touched last.
    """
    fabric, vel_before = spec.fabric, cloth.vel_w
    h = dt / spec.substeps
    relax, free = _relaxation(spec, h, held), _free(spec, held)
    mass = jnp.asarray(spec.mass, jnp.float32)

    def between(a: Array, b: Array, share: Array) -> Array:
        return a + share * (b - a)

    def solids(share: Array) -> Capsules:
        ends = between(start.a_w, end.a_w, share), between(start.b_w, end.b_w, share)
        return Capsules(*ends, end.radius)

    def substep(carry: tuple, share: Array) -> tuple[tuple, None]:
        pos, vel, pushed, touched = carry
        anchors = columns(between(anchors_start, anchors_end, share))
        fallen = _fall(spec, pos, vel, h)
        moved = relax(_hold(spec, fallen, anchors, held), anchors)
        then, now = solids(share - 1.0 / spec.substeps), solids(share)
        push, heal, which = _push_out(spec, free, moved, pos, then, now, floor)
        after = add(moved, push)
        vel = scale((1.0 - fabric.damping * h) / h, sub(after, pos))
        touched = jnp.where(which >= 0, which, touched)
        return (add(after, heal), vel, add(pushed, push), touched), None

    shares = jnp.arange(1, spec.substeps + 1) / spec.substeps
    still = jnp.zeros(spec.count)
    nothing = (still, still, still), jnp.full(spec.count, -1, jnp.int32)
    carry = (columns(cloth.pos_w), columns(cloth.vel_w), *nothing)
    (pos, vel, pushed, touched), _ = jax.lax.scan(substep, carry, shares)
    moved = Cloth(pos_w=jnp.stack(pos, -1), vel_w=jnp.stack(vel, -1))
    broken = ~(jnp.isfinite(moved.pos_w).all() & jnp.isfinite(moved.vel_w).all())
    kept = Cloth(_finite(cloth.pos_w), jnp.zeros_like(cloth.vel_w))
    cloth = jax.tree.map(lambda a, b: jnp.where(broken, a, b), kept, moved)
    force = scale(-mass / (h * dt), pushed)  # of each vertex on its solid
    own = jnp.arange(len(end.radius))[:, None] == touched

    def on_each(x: Array) -> Array:
        return jnp.where(own & ~broken, x, 0.0).sum(-1)

    net = jnp.stack(each(on_each, force), -1)
    on_all = jnp.stack(force, -1).sum(0)
    grip = jnp.where(broken, 0.0, _grip(spec, vel_before, cloth.vel_w, on_all, dt))
    total = on_each(jnp.sqrt(dot(force, force)))
    stretch = _stretch(spec, cloth.pos_w)
    return cloth, Touch(net_w=net, total=total, grip_w=grip, stretch=stretch, broken=broken)


def _grip(spec: ClothSpec, before: Array, after: Array, net_w: Array, dt: float) -> Array:
    """Force of the anchors on the free vertices [N] (3,): what else changed their momentum.

    Forces between vertices cancel. Velocities [m/s] (n, 3) are those ``before`` a physics step and ``after`` it;
    ``net_w`` is the force of the cloth on all solids and the floor [N] (3,).
    """
    mass = jnp.asarray(np.where(spec.held >= 0, 0.0, spec.mass), jnp.float32)
    drag = spec.fabric.damping * (before + after) / 2
    weight = jnp.array([0.0, 0.0, -spec.fabric.gravity * mass.sum()])
    return mass @ ((after - before) / dt + drag) + weight + net_w


def _stretch(spec: ClothSpec, pos_w: Array) -> Array:
    """Greatest length of an edge, over that at rest ()."""
    edges, pos = spec.edges, columns(pos_w)
    rows = [sub(each(partial(_take, at=at), pos), pos) for at in edges.partner]
    squared = jnp.stack([dot(off, off) for off in rows])
    return jnp.sqrt(jnp.max(squared * jnp.asarray((edges.active / edges.rest) ** 2, jnp.float32)))


def give_way(slid: Array, touch: Touch, dt: float) -> Array:
    """How far cloth has slid through the fingers that hold it, a physics step later [m] (3,).

    Where it is stretched beyond ``HELD`` it slides towards what pulls; else the fingers gather it in again. What
    is out of the hand stays so.

    Args:
        slid: from where the hand would have the anchors to where they are [m] (3,).
        touch: of the last physics step.
        dt: its length [s].
    """
    pull, spare = jnp.sqrt(jnp.maximum(jnp.sum(touch.grip_w**2), TINY)), HELD - touch.stretch
    away = jnp.sqrt(jnp.maximum(jnp.sum(slid**2), TINY))
    out = touch.grip_w / pull * (SLIDES * jnp.clip(-spare, 0.0, 1.0) * dt)
    back = slid / away * jnp.minimum(away, GATHERS * jnp.maximum(spare, 0.0) * dt)
    return jnp.where(in_hand(slid), slid - out - back, slid)


def in_hand(slid: Array) -> Array:
    """Whether fingers still hold cloth of which so much has slid through them [m] (3,)."""
    return jnp.linalg.norm(slid) <= LET_GO


def _finite(x: Array) -> Array:
    return jnp.where(jnp.isfinite(x), x, 0.0)


def _fall(spec: ClothSpec, pos: Xyz, vel: Xyz, h: float) -> Xyz:
    """Where free vertices would be after h [s]."""
    vel = (vel[0], vel[1], vel[2] + spec.fabric.gravity * h)
    return add(pos, scale(h * jnp.minimum(1.0, spec.fabric.max_speed / length(vel)), vel))


def _free(spec: ClothSpec, held: Array | None) -> Array:
    """1 for vertices that nothing holds (n,)."""
    loose = jnp.asarray(spec.held < 0, jnp.float32)
    return loose if held is None else jnp.where(held, loose, 1.0)


def _hold(spec: ClothSpec, pos: Xyz, anchors: Xyz, held: Array | None) -> Xyz:
    """Anchored vertices where the gripper has them."""
    slot = np.maximum(spec.held, 0)
    there = spec.held >= 0 if held is None else (spec.held >= 0) & held
    return each(lambda x, a: jnp.where(there, _take(a, slot), x), pos, anchors)


def _relaxation(spec: ClothSpec, h: float, held: Array | None):
    """A function of positions and anchors: one sweep over hinges, tethers and edges."""
    hinge, edge = (jnp.asarray(x, jnp.float32) for x in _all_shares(spec, spec.held >= 0, h))
    pulled = jnp.asarray(spec.held < 0, jnp.float32)
    if held is not None:
        loose = _all_shares(spec, np.zeros(spec.count, bool), h)
        hinge, edge = (jnp.where(held, a, b) for a, b in zip((hinge, edge), loose, strict=True))
        pulled = jnp.where(held, pulled, 0.0)
    rows = range(len(edge))

    def relax(pos: Xyz, anchors: Xyz) -> Xyz:
        bent = [_pull(spec.hinges, hinge, row, pos) for row in range(len(hinge))]
        for shift in bent:
            pos = add(pos, shift)
        off = sub(pos, each(partial(_take, at=spec.tether), anchors))
        inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
        excess = pulled * jnp.maximum(
            1.0 - jnp.asarray(spec.reach, jnp.float32) * inverse_length, 0.0
        )
        pos = sub(pos, scale(excess, off))
        for row in rows:
            pos = add(pos, _pull(spec.edges, edge, row, pos))
        return pos

    return relax


def _all_shares(spec: ClothSpec, held: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares of hinges and of edges, (r, n) each, while some vertices (n,) are held."""
    inverse = np.where(held, 0.0, 1.0 / spec.mass)
    hinge, edge = (_shares(p, inverse, h) for p in (spec.hinges, spec.edges))
    crowd = np.maximum(hinge.sum(0), 1e-9) / RELAXED
    # the same for both of a pair: momentum stays
    crowd = np.maximum(crowd, crowd[spec.hinges.partner])
    return hinge / np.maximum(crowd, 1.0), edge


def _shares(pairs: Pairs, inverse: np.ndarray, h: float) -> np.ndarray:
    """Share of a pair's error that its first vertex undoes in a substep (r, n)."""
    both = inverse + inverse[pairs.partner] + pairs.compliance / h**2
    return pairs.active * inverse / np.maximum(both, 1e-12)


def _pull(pairs: Pairs, share: Array, row: int, pos: Xyz) -> Xyz:
    """How one row of pairs moves every vertex [m], each (n,)."""
    partner = pairs.partner[row]
    off = sub(each(partial(_take, at=partner), pos), pos)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    rest = jnp.asarray(pairs.rest[row], jnp.float32)
    return scale(share[row] * (1.0 - rest * inverse_length), off)


def _push_out(
    spec: ClothSpec, free: Array, pos: Xyz, start: Xyz, then: Capsules, now: Capsules, floor: float | None,
) -> tuple[Xyz, Xyz, Array]:  # fmt: skip
    """How free vertices are pushed out of the nearest solid, and healed besides, and which solid that is, -1 for none.

    A push undoes what moved inwards within the substep, and up to friction * push of what slid along the solid.
    What was inside before is healed by displacement.
    """
    which, dist, normal, carried = _nearest(pos, then, now, floor)
    went = sub(sub(pos, start), carried)
    inwards = dot(went, normal)
    overlap = free * jnp.maximum(spec.fabric.thickness - dist, 0.0)
    depth = jnp.minimum(overlap, jnp.maximum(-inwards, 0.0))
    slid = sub(went, scale(inwards, normal))
    undo = jnp.minimum(
        1.0, spec.fabric.friction * depth * rsqrt(jnp.maximum(dot(slid, slid), TINY))
    )
    push = sub(scale(depth, normal), scale(undo, slid))
    return push, scale(HEALING * (overlap - depth), normal), jnp.where(depth > 0, which, -1)


def _nearest(
    pos: Xyz, then: Capsules, now: Capsules, floor: float | None
) -> tuple[Array, Array, Xyz, Xyz]:
    """Nearest solid of each vertex: which, its distance [m], its normal, how far it moved [m]; each (n,).

    The floor comes after the capsules.
    """
    count, still = len(now.radius), scale(jnp.float32(0.0), pos)
    which, dist = jnp.full_like(pos[0], count, jnp.int32), jnp.full_like(pos[0], jnp.inf)
    normal = carried = still
    if count:
        which, dist, normal, carried = _nearest_capsule(pos, then, now)
    if floor is not None:
        above = pos[2] - floor
        lower = above < dist
        which, dist = jnp.where(lower, count, which), jnp.minimum(above, dist)
        x, y, z = (jnp.where(lower, 0.0, n) for n in normal)
        normal = x, y, jnp.where(lower, 1.0, z)
        carried = each(lambda c: jnp.where(lower, 0.0, c), carried)
    return which, dist, normal, carried


def _nearest_capsule(pos: Xyz, then: Capsules, now: Capsules) -> tuple[Array, Array, Xyz, Xyz]:
    """The same among capsules. Only distances are of all: everything else is computed again for the one."""
    which = jnp.argmin(now.touching(pos, then).dist, axis=0).astype(jnp.int32)
    own = lambda x: each(partial(_take, at=which), columns(x))  # noqa: E731
    a, b, moved_a, moved_b = map(own, (now.a_w, now.b_w, now.a_w - then.a_w, now.b_w - then.b_w))
    from_a, axis = sub(pos, a), sub(b, a)
    share = jnp.clip(dot(from_a, axis) / jnp.maximum(dot(axis, axis), TINY), 0.0, 1.0)
    off = sub(from_a, scale(share, axis))
    gap = length(off)
    carried = add(moved_a, scale(share, sub(moved_b, moved_a)))
    return which, gap - _take(now.radius, which), scale(1.0 / gap, off), carried


def _take(x: Array, at: Array | np.ndarray) -> Array:
    """Entries that exist; checking that they do would cost more than taking them."""
    return x.at[at].get(mode="promise_in_bounds")
