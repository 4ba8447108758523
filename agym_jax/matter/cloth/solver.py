"""Cloth: extended position-based dynamics (XPBD) of one garment in one environment, in plain JAX beside MJX.

A physics step is divided into short substeps of one sweep each ("small steps": for the same work stiffer than
many sweeps of long steps). In a substep vertices fall freely; bending springs and tethers to the anchors act;
the edges are projected colour by colour; finally vertices are moved out of the nearest solid, with Coulomb
friction. Velocities follow from positions, so collisions are inelastic, and the impulses of the last part are
exactly what acts on the solids: impulse over time is the force [N].

Anchors move with the gripper, or lag behind it where the cloth slides through its fingers (``slip``):
a limb would pass between two vertices whose edge is stretched to several times its length. Tethers are
limits: no vertex is farther from its nearest anchor than the distance along the cloth, times ``Fabric.give``. They carry the weight of the
hanging cloth, which single sweeps would propagate to the gripper only slowly.

Nothing is scattered, and between two gathers all operations are per vertex. On an NVIDIA GPU all substeps are
one kernel (``cloth.kernel``); elsewhere XLA makes one per colour, and the last one includes the contacts.

DEVIATION(no-self-contact): cloth does not touch itself, as AG's does not. Bending keeps the sleeve open.
DEVIATION(grip-slips): a gown that is caught slides through the fingers instead of being pulled through the limb;
when it comes free they gather it in again, and when more than 15 cm have slid through it is out of the hand for the
rest of the episode. AG's anchors never slip.
DEVIATION(gripper-feels-nothing): anchors do not push back on the robot: the gown weighs 54 g.
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
from agym_jax.matter.cloth.topology import ClothSpec, PairTable, Tables, tables
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

RECOVERY_SHARE = 0.2
"""Share of an earlier penetration of a solid that is removed in a substep: by displacement, without speed or force."""
SLIP_STRETCH = 3.0
"""Cloth slips when its most stretched edge is more than this many times as long as at rest."""
SLIP_RATE, GATHER_RATE = 3.0, 0.5
"""Speed [m/s] at which cloth slides through the fingers per unit of stretch above ``SLIP_STRETCH`` (at most one), and
at which the fingers gather it in again per unit of stretch below."""
MAX_SLIP = 0.15
"""When more than this has slid through the fingers, the cloth is out of the hand [m]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cloth:
    """State of n vertices."""

    pos_w: Array  # [m]                                                     (n, 3)
    vel_w: Array  # [m/s]                                                   (n, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ClothContact:
    """Contact of the cloth with k capsules, and its pull on the anchors: means over a physics step."""

    net_w: Array  # force of the cloth, world [N]                           (k, 3)
    total: Array  # sum over vertices of the magnitudes of their forces [N] (k,)
    grip_w: Array  # force with which the anchors hold the rest, world [N]  (3,)
    stretch: Array  # greatest ratio of an edge's length to that at rest    ()
    broken: Array  # the cloth became non-finite and was reset to before    () bool


def initial(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Cloth:
    """The garment at rest, held at a point: in its hanging shape, or undeformed if it has none.

    Args:
        spec: of the cloth.
        pos_w: origin of the garment's frame, world [m] (3,).
        rot_w: orientation of that frame (3, 3); upright, pulled along world y, if left out.
    """
    g = spec.garment
    at_rest = jnp.asarray(g.vertices if g.hanging is None else g.hanging, jnp.float32)
    turned = at_rest if rot_w is None else at_rest @ rot_w.T
    return Cloth(pos_w=pos_w + turned, vel_w=jnp.zeros_like(at_rest))


def anchor_positions(spec: ClothSpec, pos_w: Array, rot_w: Array | None = None) -> Array:
    """Positions of the anchors of a garment that is held at a point, world [m] (a, 3).

    Args:
        spec: of the cloth.
        pos_w: origin of the garment's frame, world [m] (3,).
        rot_w: orientation of that frame (3, 3); upright if left out.
    """
    local = jnp.asarray(spec.garment.vertices[spec.garment.anchors], jnp.float32)
    return pos_w + (local if rot_w is None else local @ rot_w.T)


def step(
    spec: ClothSpec, cloth: Cloth, start: Capsules, end: Capsules, anchors_start: Array, anchors_end: Array, dt: float,
    held: Array | None = None, floor: float | None = None, taper: Array | None = None,
) -> tuple[Cloth, ClothContact]:  # fmt: skip
    """Advance by one physics step, while solids and anchors move along straight lines.

    Args:
        spec: of the cloth.
        cloth: n vertices.
        start: the k solids at the beginning of the step: limbs, torso, furniture.
        end: the k solids at its end.
        anchors_start: positions of the anchors at the beginning of the step, world [m] (a, 3).
        anchors_end: positions of the anchors at its end, world [m] (a, 3).
        dt: length of the step [s].
        held: whether the anchors hold the cloth, () bool; they do if left out.
        floor: height of the floor [m]; there is none if left out.
        taper: how much thinner each capsule is at its ends than in the middle [m] (k,), linear in between; where that
            is more than its radius and the cloth's thickness, nothing is there. Capsules do not taper if left out.

    Returns:
        cloth, and its contact forces. A vertex counts for the solid that it touched last.
    """
    h, vel_before = dt / spec.substeps, cloth.vel_w
    mass = jnp.asarray(spec.mass, jnp.float32)
    substep = partial(_substep, spec, h, len(end.radius), floor)
    path = _trajectory(spec.substeps, start, end, anchors_start, anchors_end, taper)
    *after, pushed, touched = advance(
        substep, tables(spec, h), cloth.pos_w, cloth.vel_w, path, held
    )
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
    return cloth, ClothContact(net_w=net, total=total, grip_w=grip, stretch=stretch, broken=broken)


def _grip(spec: ClothSpec, before: Array, after: Array, net_w: Array, dt: float) -> Array:
    """Force of the anchors on the free vertices [N] (3,), from the change of their momentum.

    Forces between vertices cancel. Velocities [m/s] (n, 3) are those ``before`` a physics step and ``after`` it;
    ``net_w`` is the force of the cloth on all solids and the floor [N] (3,).
    """
    mass = jnp.asarray(np.where(spec.held >= 0, 0.0, spec.mass), jnp.float32)

    def rate(before: Array, after: Array) -> Array:
        drag = spec.fabric.damping * (before + after) / 2
        return jnp.sum(mass * ((after - before) / dt + drag))

    weight = jnp.array([0.0, 0.0, -spec.fabric.gravity * mass.sum()])
    # by component: on a GPU, sums of (n,) are faster than (n,) @ (n, 3) in each environment
    return jnp.stack(list(map(rate, columns(before), columns(after)))) + weight + net_w


def _stretch(spec: ClothSpec, pos_w: Array) -> Array:
    """Greatest ratio of an edge's length to that at rest ()."""
    edges, pos = spec.edges, columns(pos_w)
    rows = [sub(_vectors(InArrays(pos), at), pos) for at in edges.partner]
    squared = jnp.stack([dot(off, off) for off in rows])
    return jnp.sqrt(jnp.max(squared * jnp.asarray((edges.active / edges.rest) ** 2, jnp.float32)))


def slip(slid: Array, touch: ClothContact, dt: float) -> Array:
    """Displacement of the cloth through the fingers that hold it, after a physics step [m] (3,).

    Cloth that is stretched beyond ``SLIP_STRETCH`` slides in the direction of the pull; otherwise the fingers gather
    it in again. Cloth that is out of the hand stays so.

    Args:
        slid: displacement before the step, from the anchors' positions in the hand to where they are [m] (3,).
        touch: contact in this physics step.
        dt: length of the step [s].
    """
    pull, spare = (
        jnp.sqrt(jnp.maximum(jnp.sum(touch.grip_w**2), TINY)),
        SLIP_STRETCH - touch.stretch,
    )
    away = jnp.sqrt(jnp.maximum(jnp.sum(slid**2), TINY))
    out = touch.grip_w / pull * (SLIP_RATE * jnp.clip(-spare, 0.0, 1.0) * dt)
    back = slid / away * jnp.minimum(away, GATHER_RATE * jnp.maximum(spare, 0.0) * dt)
    return jnp.where(in_hand(slid), slid - out - back, slid)


def in_hand(slid: Array) -> Array:
    """Whether the fingers still hold cloth after a displacement through them [m] (3,): () bool."""
    return jnp.linalg.norm(slid) <= MAX_SLIP


def _finite(x: Array) -> Array:
    return jnp.where(jnp.isfinite(x), x, 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Trajectory:
    """Anchors and solids in each of s substeps. In the physics the fields are ``Rows`` of one substep."""

    anchors: Array  # positions at the substep's end, world [m]             (s, 3, a)
    a: Array  # one end of each capsule at the substep's end, world [m]     (s, 3, k)
    axis: Array  # from there to the other end [m]                          (s, 3, k)
    moved: Array  # displacement of the one end in the substep [m]          (s, 3, k)
    turned: Array  # displacement of the other end, relative to that [m]    (s, 3, k)
    inverse: Array  # 1 / squared length [1/m^2]                            (s, 1, k)
    radius: Array  # [m]                                                    (s, 1, k)
    taper: Array | None  # how much thinner it is at its ends [m]           (s, 1, k)


def _trajectory(
    substeps: int, start: Capsules, end: Capsules, anchors_start: Array, anchors_end: Array, taper: Array | None,
) -> _Trajectory:  # fmt: skip
    """Straight lines, divided into substeps."""
    share = jnp.arange(substeps + 1)[:, None, None] / substeps

    def between(a: Array, b: Array) -> Array:
        return a.T + share * (b - a).T

    def always(x: Array) -> Array:
        return jnp.broadcast_to(x, (substeps, 1, len(x)))

    a, b = between(start.a_w, end.a_w), between(start.b_w, end.b_w)
    axis = b - a
    squared = jnp.maximum(jnp.sum(axis**2, 1, keepdims=True), TINY)
    return _Trajectory(
        anchors=between(anchors_start, anchors_end)[1:],
        a=a[1:],
        axis=axis[1:],
        moved=a[1:] - a[:-1],
        turned=axis[1:] - axis[:-1],
        inverse=1.0 / squared[1:],
        radius=always(end.radius),
        taper=None if taper is None else always(taper),
    )


def _substep(
    spec: ClothSpec, h: float, solids: int, floor: float | None, tables: Tables, now: _Trajectory, publish: Publish, state: State,
) -> State:  # fmt: skip
    """The state after h [s], among a number of capsules."""
    pos, vel, pushed, touched = state
    free, tether = tables.free[0], tables.tether[0]
    anchor = _vectors(now.anchors, tether)
    fallen = map_xyz(partial(jnp.where, free > 0), _fall(spec, pos, vel, h), anchor)
    moved = _relax(spec, tables, publish, fallen, anchor)
    push, recovery, which = _contacts(spec, free, moved, pos, now, solids, floor)
    after = add(moved, push)
    vel = scale((1.0 - spec.fabric.damping * h) / h, sub(after, pos))
    return add(after, recovery), vel, add(pushed, push), jnp.where(which >= 0, which, touched)


def _vectors(rows: Rows, at: int | Array) -> Xyz:
    """Vectors at some columns of the rows x, y and z."""
    return rows[0, at], rows[1, at], rows[2, at]


def _fall(spec: ClothSpec, pos: Xyz, vel: Xyz, h: float) -> Xyz:
    """Positions of free vertices after h [s] of free fall."""
    vel = (vel[0], vel[1], vel[2] + spec.fabric.gravity * h)
    return add(pos, scale(h * jnp.minimum(1.0, spec.fabric.max_speed / length(vel)), vel))


def _relax(spec: ClothSpec, tables: Tables, publish: Publish, pos: Xyz, anchor: Xyz) -> Xyz:
    """One sweep over hinges, tethers and edges. ``anchor`` is the position of each vertex's anchor."""
    others, before = publish(pos), pos
    for row in range(len(spec.hinges.partner)):
        pos = add(pos, _correction(tables.hinges, row, before, others))
    off = sub(pos, anchor)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    excess = tables.free[0] * jnp.maximum(1.0 - tables.reach[0] * inverse_length, 0.0)
    pos = sub(pos, scale(excess, off))
    for row in range(len(spec.edges.partner)):
        pos = add(pos, _correction(tables.edges, row, pos, publish(pos)))
    return pos


def _correction(pairs: PairTable, row: int, pos: Xyz, others: Rows) -> Xyz:
    """Correction of each vertex by one row of distance constraints [m], each (n,)."""
    off = sub(_vectors(others, pairs.partner[row]), pos)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    return scale(pairs.share[row] * (1.0 - pairs.rest[row] * inverse_length), off)


def _contacts(
    spec: ClothSpec, free: Array, pos: Xyz, start: Xyz, now: _Trajectory, solids: int, floor: float | None,
) -> tuple[Xyz, Xyz, Array]:  # fmt: skip
    """Contacts of free vertices with their nearest solids.

    Returns:
        push: undoes inward motion within the substep, and up to friction * push of the sliding along the solid [m].
        recovery: displacement that removes a share of an earlier penetration, without force [m].
        which: index of the solid, -1 for none (n,).
    """
    which, dist, normal, carried = _nearest(pos, now, solids, floor)
    went = sub(sub(pos, start), carried)
    inwards = dot(went, normal)
    overlap = free * jnp.maximum(spec.fabric.thickness - dist, 0.0)
    depth = jnp.minimum(overlap, jnp.maximum(-inwards, 0.0))
    slid = sub(went, scale(inwards, normal))
    undo = jnp.minimum(
        1.0, spec.fabric.friction * depth * rsqrt(jnp.maximum(dot(slid, slid), TINY))
    )
    push = sub(scale(depth, normal), scale(undo, slid))
    return push, scale(RECOVERY_SHARE * (overlap - depth), normal), jnp.where(depth > 0, which, -1)


def _nearest(
    pos: Xyz, now: _Trajectory, solids: int, floor: float | None
) -> tuple[Array, Array, Xyz, Xyz]:
    """Nearest solid of each vertex: index, distance [m], normal, displacement of its surface [m]; each (n,).

    The floor's index is the number of capsules.
    """
    zero = scale(jnp.float32(0.0), pos)
    which, dist = jnp.full_like(pos[0], solids, jnp.int32), jnp.full_like(pos[0], jnp.inf)
    normal = carried = zero
    if solids:
        which, dist, normal, carried = _nearest_capsule(pos, now, solids)
    if floor is not None:
        above = pos[2] - floor
        lower = above < dist
        which, dist = jnp.where(lower, solids, which), jnp.minimum(above, dist)
        x, y, z = (jnp.where(lower, 0.0, n) for n in normal)
        normal = x, y, jnp.where(lower, 1.0, z)
        carried = map_xyz(lambda c: jnp.where(lower, 0.0, c), carried)
    return which, dist, normal, carried


def _nearest_capsule(pos: Xyz, now: _Trajectory, count: int) -> tuple[Array, Array, Xyz, Xyz]:
    """``_nearest`` among capsules. Only distances are computed for all; the rest again for the nearest one."""

    def offset(k: int | Array) -> tuple[Array, Xyz]:
        """Nearest point of a capsule's axis, in 0..1 from end a, and the vector from there [m]."""
        from_a, axis = sub(pos, _vectors(now.a, k)), _vectors(now.axis, k)
        share = jnp.clip(dot(from_a, axis) * now.inverse[0, k], 0.0, 1.0)
        return share, sub(from_a, scale(share, axis))

    def radius(k: int | Array, share: Array) -> Array:
        """Of a capsule, at a point of its axis [m]."""
        middle = now.radius[0, k]
        if now.taper is None:
            return middle
        return middle - now.taper[0, k] * jnp.abs(2.0 * share - 1.0)

    which, least = jnp.zeros_like(pos[0], jnp.int32), jnp.full_like(pos[0], jnp.inf)
    for k in range(count):
        share, off = offset(k)
        dist = length(off) - radius(k, share)
        nearer = (dist < least) | jnp.isnan(
            dist
        )  # a solid that is not finite makes the cloth non-finite
        which, least = jnp.where(nearer, k, which), jnp.minimum(dist, least)
    share, off = offset(which)
    gap = length(off)
    carried = add(_vectors(now.moved, which), scale(share, _vectors(now.turned, which)))
    return which, gap - radius(which, share), scale(1.0 / gap, off), carried
