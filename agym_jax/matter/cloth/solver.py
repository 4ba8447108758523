"""Cloth: extended position-based dynamics of one garment in one environment, in plain JAX beside MJX.

A physics step is cut into short substeps, each with one sweep ("small steps": for the same work stiffer than
many sweeps of long steps). In a substep vertices fall freely; bending springs and tethers to the anchors act;
the edges are relaxed colour by colour, each wholly; at last vertices are put outside the nearest solid, with Coulomb
friction. Velocities follow from positions, so collisions are inelastic, and the impulses of the last part are
exactly what the solids feel: impulse over time is the force [N].

Anchors are where the gripper carries them, or behind it where the cloth slides through its fingers (``slip``):
between two vertices whose edge is stretched to several times its length a limb would come through. Tethers are
limits: no vertex is farther from its nearest anchor than the way along the cloth. They carry the weight of what
hangs, which single sweeps would take long to hand up to the gripper.

Nothing is scattered, and between two gathers everything belongs to one vertex. On an NVIDIA GPU all substeps are
one kernel (``cloth_kernel``); elsewhere XLA makes one of each colour, and the last one does the contacts too.

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

from agym_jax.matter.cloth.kernel import InArrays, Publish, Rows, State, advance
from agym_jax.matter.cloth.topology import ClothSpec, Sweep, Tables, tables
from agym_jax.matter.shapes import (
    TINY,
    Capsules,
    Xyz,
    add,
    columns,
    dot,
    length,
    map_xyz,
    scale,
    sub,
)

HEALING = 0.2
"""Share of an old overlap with a solid that heals in a substep: by displacement, without speed or force."""
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
    h, vel_before = dt / spec.substeps, cloth.vel_w
    mass = jnp.asarray(spec.mass, jnp.float32)
    substep = partial(_substep, spec, h, len(end.radius), floor)
    way = _way(spec.substeps, start, end, anchors_start, anchors_end)
    *after, pushed, touched = advance(substep, tables(spec, h), cloth.pos_w, cloth.vel_w, way, held)
    moved = Cloth(*after)
    broken = ~(jnp.isfinite(moved.pos_w).all() & jnp.isfinite(moved.vel_w).all())
    kept = Cloth(_finite(cloth.pos_w), jnp.zeros_like(cloth.vel_w))
    cloth = jax.tree.map(lambda a, b: jnp.where(broken, a, b), kept, moved)
    force = scale(-mass / (h * dt), pushed)  # of each vertex on its solid
    own = jnp.arange(len(end.radius))[:, None] == touched

    def on_each(x: Array) -> Array:
        return jnp.where(own & ~broken, x, 0.0).sum(-1)

    net = jnp.stack(map_xyz(on_each, force), -1)
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
    rows = [sub(_look(InArrays(pos), at), pos) for at in edges.partner]
    squared = jnp.stack([dot(off, off) for off in rows])
    return jnp.sqrt(jnp.max(squared * jnp.asarray((edges.active / edges.rest) ** 2, jnp.float32)))


def slip(slid: Array, touch: Touch, dt: float) -> Array:
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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Way:
    """Where the a anchors and the k solids are in each of s substeps; ``Rows`` of one of them in the physics."""

    anchors: Array  # at its end, world [m]                                 (s, 3, a)
    a: Array  # one end of each capsule, at its end, world [m]              (s, 3, k)
    axis: Array  # from there to the other end [m]                          (s, 3, k)
    moved: Array  # how far the one end moved in it [m]                     (s, 3, k)
    turned: Array  # how much farther the other end moved [m]               (s, 3, k)
    inverse: Array  # 1 / squared length [1/m^2]                            (s, 1, k)
    radius: Array  # [m]                                                    (s, 1, k)


def _way(
    substeps: int, start: Capsules, end: Capsules, anchors_start: Array, anchors_end: Array
) -> _Way:
    """Straight lines, cut into substeps."""
    share = jnp.arange(substeps + 1)[:, None, None] / substeps

    def between(a: Array, b: Array) -> Array:
        return a.T + share * (b - a).T

    a, b = between(start.a_w, end.a_w), between(start.b_w, end.b_w)
    axis = b - a
    squared = jnp.maximum(jnp.sum(axis**2, 1, keepdims=True), TINY)
    return _Way(
        anchors=between(anchors_start, anchors_end)[1:],
        a=a[1:],
        axis=axis[1:],
        moved=a[1:] - a[:-1],
        turned=axis[1:] - axis[:-1],
        inverse=1.0 / squared[1:],
        radius=jnp.broadcast_to(end.radius, (substeps, 1, len(end.radius))),
    )


def _substep(
    spec: ClothSpec, h: float, solids: int, floor: float | None, tables: Tables, moment: _Way, publish: Publish, state: State,
) -> State:  # fmt: skip
    """The state after h [s], among a number of solids."""
    pos, vel, pushed, touched = state
    free, tether = tables.free[0], tables.tether[0]
    anchor = _look(moment.anchors, tether)
    fallen = map_xyz(partial(jnp.where, free > 0), _fall(spec, pos, vel, h), anchor)
    moved = _relax(spec, tables, publish, fallen, anchor)
    push, heal, which = _push_out(spec, free, moved, pos, moment, solids, floor)
    after = add(moved, push)
    vel = scale((1.0 - spec.fabric.damping * h) / h, sub(after, pos))
    return add(after, heal), vel, add(pushed, push), jnp.where(which >= 0, which, touched)


def _look(rows: Rows, at: int | Array) -> Xyz:
    """Vectors of some numbers, from rows x, y and z."""
    return rows[0, at], rows[1, at], rows[2, at]


def _fall(spec: ClothSpec, pos: Xyz, vel: Xyz, h: float) -> Xyz:
    """Where free vertices would be after h [s]."""
    vel = (vel[0], vel[1], vel[2] + spec.fabric.gravity * h)
    return add(pos, scale(h * jnp.minimum(1.0, spec.fabric.max_speed / length(vel)), vel))


def _relax(spec: ClothSpec, tables: Tables, publish: Publish, pos: Xyz, anchor: Xyz) -> Xyz:
    """One sweep over hinges, tethers and edges. Each vertex has its ``anchor``."""
    seen, before = publish(pos), pos
    for row in range(len(spec.hinges.partner)):
        pos = add(pos, _pull(tables.hinges, row, before, seen))
    off = sub(pos, anchor)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    excess = tables.free[0] * jnp.maximum(1.0 - tables.reach[0] * inverse_length, 0.0)
    pos = sub(pos, scale(excess, off))
    for row in range(len(spec.edges.partner)):
        pos = add(pos, _pull(tables.edges, row, pos, publish(pos)))
    return pos


def _pull(pairs: Sweep, row: int, pos: Xyz, seen: Rows) -> Xyz:
    """How one row of pairs moves every vertex [m], each (n,)."""
    off = sub(_look(seen, pairs.partner[row]), pos)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    return scale(pairs.share[row] * (1.0 - pairs.rest[row] * inverse_length), off)


def _push_out(
    spec: ClothSpec, free: Array, pos: Xyz, start: Xyz, moment: _Way, solids: int, floor: float | None,
) -> tuple[Xyz, Xyz, Array]:  # fmt: skip
    """How free vertices are pushed out of the nearest solid, and healed besides, and which solid that is, -1 for none.

    A push undoes what moved inwards within the substep, and up to friction * push of what slid along the solid.
    What was inside before is healed by displacement.
    """
    which, dist, normal, carried = _nearest(pos, moment, solids, floor)
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
    pos: Xyz, moment: _Way, solids: int, floor: float | None
) -> tuple[Array, Array, Xyz, Xyz]:
    """Nearest solid of each vertex: which, its distance [m], its normal, how far it moved [m]; each (n,).

    The floor comes after the capsules.
    """
    still = scale(jnp.float32(0.0), pos)
    which, dist = jnp.full_like(pos[0], solids, jnp.int32), jnp.full_like(pos[0], jnp.inf)
    normal = carried = still
    if solids:
        which, dist, normal, carried = _nearest_capsule(pos, moment, solids)
    if floor is not None:
        above = pos[2] - floor
        lower = above < dist
        which, dist = jnp.where(lower, solids, which), jnp.minimum(above, dist)
        x, y, z = (jnp.where(lower, 0.0, n) for n in normal)
        normal = x, y, jnp.where(lower, 1.0, z)
        carried = map_xyz(lambda c: jnp.where(lower, 0.0, c), carried)
    return which, dist, normal, carried


def _nearest_capsule(pos: Xyz, moment: _Way, count: int) -> tuple[Array, Array, Xyz, Xyz]:
    """The same among capsules. Only distances are of all: everything else is computed again for the one."""

    def offset(k: int | Array) -> tuple[Array, Xyz]:
        """Where along its axis a capsule is nearest, in 0..1, and the way from there [m]."""
        from_a, axis = sub(pos, _look(moment.a, k)), _look(moment.axis, k)
        share = jnp.clip(dot(from_a, axis) * moment.inverse[0, k], 0.0, 1.0)
        return share, sub(from_a, scale(share, axis))

    which, least = jnp.zeros_like(pos[0], jnp.int32), jnp.full_like(pos[0], jnp.inf)
    for k in range(count):
        dist = length(offset(k)[1]) - moment.radius[0, k]
        nearer = (dist < least) | jnp.isnan(dist)  # where a solid is nowhere, neither is the cloth
        which, least = jnp.where(nearer, k, which), jnp.minimum(dist, least)
    share, off = offset(which)
    gap = length(off)
    carried = add(_look(moment.moved, which), scale(share, _look(moment.turned, which)))
    return which, gap - moment.radius[0, which], scale(1.0 / gap, off), carried
