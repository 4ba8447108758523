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

from agym_jax.matter.cloth.grid import Grid
from agym_jax.matter.cloth.kernel import InArrays, Publish, Rows, State, advance
from agym_jax.matter.cloth.nearest import Solids, Trajectory, nearest, trajectory, vectors
from agym_jax.matter.cloth.robot_links import Links
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
    held: Array | None = None, floor: float | None = None, grid: Grid | None = None, links: Links | None = None,
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
        grid: which capsules the cloth finds as AG's does; none if left out.
        links: those of the robot, whose forces are only in ``grip_w``; none if left out.

    Returns:
        cloth, and its contact forces. A vertex counts for the solid that it touched last, also for what another did in the same step.
    """
    h, vel_before = dt / spec.substeps, cloth.vel_w
    mass = jnp.asarray(spec.mass, jnp.float32)
    solids = Solids(len(end.radius), grid.which if grid else (), spec.fabric.thickness, floor,
                    links.grids.layouts if links else ())  # fmt: skip
    substep = partial(_substep, spec, h, solids)
    path = trajectory(spec.substeps, start, end, anchors_start, anchors_end, grid, links)
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
    ``net_w`` is the force of the cloth on all solids, the robot and the floor [N] (3,).
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
    rows = [sub(vectors(InArrays(pos), at), pos) for at in edges.partner]
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


def _substep(
    spec: ClothSpec, h: float, solids: Solids, tables: Tables, now: Trajectory, publish: Publish, state: State,
) -> State:  # fmt: skip
    """The state after h [s]."""
    pos, vel, pushed, touched = state
    free, tether = tables.free[0], tables.tether[0]
    anchor = vectors(now.anchors, tether)
    fallen = map_xyz(partial(jnp.where, free > 0), _fall(spec, pos, vel, h), anchor)
    moved = _relax(spec, tables, publish, fallen, anchor)
    push, recovery, which = _contacts(spec, free, moved, pos, now, solids)
    after = add(moved, push)
    vel = scale((1.0 - spec.fabric.damping * h) / h, sub(after, pos))
    return add(after, recovery), vel, add(pushed, push), jnp.where(which >= 0, which, touched)


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
    off = sub(vectors(others, pairs.partner[row]), pos)
    inverse_length = rsqrt(jnp.maximum(dot(off, off), TINY))
    return scale(pairs.share[row] * (1.0 - pairs.rest[row] * inverse_length), off)


def _contacts(
    spec: ClothSpec, free: Array, pos: Xyz, start: Xyz, now: Trajectory, solids: Solids
) -> tuple[Xyz, Xyz, Array]:
    """Contacts of free vertices with their nearest solids.

    Returns:
        push: undoes inward motion within the substep, and up to friction * push of the sliding along the solid [m].
        recovery: displacement that removes a share of an earlier penetration, without force [m].
        which: index of the solid, -1 for none (n,).
    """
    which, dist, normal, carried = nearest(pos, now, solids)
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
