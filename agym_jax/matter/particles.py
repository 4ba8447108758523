"""Food and water: spheres moved by position-based dynamics, one world, beside MJX.

In every substep the particles fall freely, are pushed out of the person, the furniture and the floor,
and then, in the moving frame of the vessel, a few sweeps push them out of each other and of the
vessel's wall (``pushes.py``). Velocities follow from positions, so collisions are inelastic (restitution 0,
as in AG); old overlaps heal slowly, so that they never turn into bounces.

A particle may not change the side of the vessel's wall within a substep, however fast it or the vessel
moves: the way from its old to its new position, in the vessel's frame, either passes the opening or is
undone. Particles are masked by ``alive``; a masked one neither moves nor collides.

Facts of Assistive Gym: reference tasks.md sections 1.3, 1.4, 4 and 5. Bullet multiplies the friction of
both bodies, so that its spheres of friction 0.5 touch spoon and cup, and each other, with 0.25.

DEVIATION(no-spin): particles do not rotate. AG's roll; a smaller friction, 0.1, has the same effect:
it was chosen so that food and water leave the tilted spoon and cup at the same angles as spheres that do
rotate, of friction 0.25, in MuJoCo. A single particle therefore lies still on a slope below 5.7 degrees.
DEVIATION(one-way): particles do not push back on tool, robot and person: they weigh 8 g and 64 g.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.matter.pushes import CALM, EAGER, push_out, push_pairs, push_vessel
from agym_jax.matter.shapes import (
    Boxes,
    Capsules,
    Touching,
    Xyz,
    add,
    columns,
    floor_touching,
    length,
    rotation,
    scale,
    sub,
    turn,
    turn_back,
)
from agym_jax.matter.vessels import CUP, SPOON, Vessel

AWAY = 100.0
"""Masked particles are computed this far from each other and from everything [m]."""


@dataclass(frozen=True)
class ParticleSpec:
    """What the particles of a task are, what holds them, and how they are stepped.

    Attributes:
        vessel: that holds them.
        count: n, particles.
        radius: [m].
        mass: of one [kg].
        friction: with everything, each other included.
        damping: of velocities [1/s].
        gravity: along world z [m/s^2].
        substeps: in one physics step.
        sweeps: Jacobi iterations in one substep.
        max_speed: particles are never faster [m/s].
    """

    vessel: Vessel
    count: int
    radius: float = 0.005
    mass: float = 0.001
    friction: float = 0.1
    damping: float = 0.04  # Bullet's default
    gravity: float = -9.81
    substeps: int = 2
    sweeps: int = 2
    max_speed: float = 6.0


FOOD = ParticleSpec(SPOON, count=8, substeps=3)
"""AG feeding.py reset: 2 x 2 x 2 spheres; physics steps of 10 ms, so substeps of 3.3 ms."""
WATER = ParticleSpec(CUP, count=64, substeps=4)
"""AG drinking.py reset: 4 x 4 x 4 spheres, a taller heap: substeps of 2.5 ms."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Particles:
    """State of n particles."""

    pos_w: Array  # centres [m]                                             (n, 3)
    vel_w: Array  # [m/s]                                                   (n, 3)
    alive: Array  # False once captured, spilled away or lost               (n,) bool

    def remove(self, mask: Array) -> Particles:
        """Take the particles of a mask (n,) out of the simulation; they stay where they were."""
        return replace(self, alive=self.alive & ~mask)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Obstacles:
    """What particles can touch. As a motion, what moves has a leading axis T of moments."""

    vessel_pos_w: Array  # [m]                                              (T?, 3)
    vessel_quat_w: Array  # wxyz                                            (T?, 4)
    person: Capsules  # ends (T?, k, 3), radii (k,)
    furniture: Boxes  # at rest
    floor: Array  # height [m]                                              ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """What every particle touched in the last physics step; masked ones touch nothing."""

    vessel: Array  # (n,) bool
    person: Array  # (n,) bool
    furniture: Array  # (n,) bool
    floor: Array  # (n,) bool
    lost: Array  # that went non-finite on the whole way and were masked    () int32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Moving:
    """The obstacles that move, at one substep; over all of them with a leading axis."""

    pos_w: Array  # of the vessel                                           (3,)
    rot_w: Array  # of the vessel                                           (3, 3)
    a_w: Array  # ends of the person's capsules                             (k, 3)
    b_w: Array  # the same                                                  (k, 3)

    def local(self, pos_w: Xyz) -> Xyz:
        """In the vessel's frame, from the world [m], each (n,)."""
        return turn_back(self.rot_w, sub(pos_w, columns(self.pos_w)))


def step(
    spec: ParticleSpec, particles: Particles, start: Obstacles, end: Obstacles, dt: float
) -> tuple[Particles, Contact]:
    """Advance by one physics step.

    Args:
        spec: of the particles.
        particles: n of them.
        start: obstacles at its beginning.
        end: at its end.
        dt: its length [s].
    """
    pair = lambda a, b: jnp.stack([a, b])  # noqa: E731
    person = replace(
        end.person,
        a_w=pair(start.person.a_w, end.person.a_w),
        b_w=pair(start.person.b_w, end.person.b_w),
    )
    motion = replace(
        end,
        vessel_pos_w=pair(start.vessel_pos_w, end.vessel_pos_w),
        vessel_quat_w=pair(start.vessel_quat_w, end.vessel_quat_w),
        person=person,
    )
    return advance(spec, particles, motion, dt)


def advance(
    spec: ParticleSpec, particles: Particles, motion: Obstacles, dt: float
) -> tuple[Particles, Contact]:
    """Advance by T - 1 physics steps along recorded poses of the obstacles.

    Args:
        spec: of the particles.
        particles: n of them.
        motion: obstacles, what moves with a leading axis T: at the beginning and after each step.
        dt: length of one physics step [s].

    Returns:
        particles, and what they touched in the last physics step.
    """
    h = dt / spec.substeps
    alive = particles.alive & _is_finite(particles.pos_w, particles.vel_w)
    masked = AWAY * jnp.arange(1.0, spec.count + 1.0)
    pos = tuple(jnp.where(alive, x, masked) for x in columns(particles.pos_w))
    vel = tuple(jnp.where(alive, x, 0.0) for x in columns(particles.vel_w))

    moments = _interpolate(motion, spec.substeps)
    first = jax.tree.map(lambda x: x[0], moments)
    local, alone = first.local(pos), jnp.zeros_like(masked)
    _, contacts = push_pairs(spec.radius, spec.friction, local, local, alone, jnp.float32(CALM), h)
    unseen = (jnp.zeros(spec.count, bool),) * 4

    def substep(carry: tuple, moment: tuple[_Moving, Array]) -> tuple[tuple, None]:
        (pos, vel, contacts, before, seen), (now, begins) = carry, moment
        pos, vel, contacts, touched = _substep(spec, pos, vel, contacts, before, now, motion, h)
        seen = tuple((a & ~begins) | b for a, b in zip(seen, touched, strict=True))
        return (pos, vel, contacts, now, seen), None

    later = jax.tree.map(lambda x: x[1:], moments)
    begins = jnp.arange(len(later.pos_w)) % spec.substeps == 0  # a physics step
    carry, _ = jax.lax.scan(substep, (pos, vel, contacts, first, unseen), (later, begins))
    pos, vel = (jnp.stack(x, -1) for x in carry[:2])
    seen = carry[-1]
    moves = alive & _is_finite(pos, vel)
    kept = jnp.where(jnp.isfinite(particles.pos_w), particles.pos_w, 0.0)
    moved = Particles(
        pos_w=jnp.where(moves[:, None], pos, kept),
        vel_w=jnp.where(moves[:, None], vel, 0.0),
        alive=moves,
    )
    lost = jnp.sum(particles.alive & ~moves, dtype=jnp.int32)
    return moved, Contact(*(s & moves for s in seen), lost=lost)


def _substep(
    spec: ParticleSpec, start: Xyz, vel: Xyz, contacts: Array, before: _Moving, now: _Moving,
    motion: Obstacles, h: float,
) -> tuple[Xyz, Xyz, Array, tuple[Array, ...]]:  # fmt: skip
    """One substep of length h [s]: positions, velocities, pair contacts, and who touched what."""
    radius, friction = spec.radius, spec.friction
    vel = (vel[0], vel[1], vel[2] + spec.gravity * h)
    vel = scale(jnp.minimum(1.0, spec.max_speed / length(vel)), vel)
    free = add(start, scale(h, vel))

    then = Capsules(before.a_w, before.b_w, motion.person.radius)
    solids = (
        Capsules(now.a_w, now.b_w, motion.person.radius).touching(free, then),
        motion.furniture.touching(free),
        floor_touching(free, motion.floor),
    )
    pos, touched = push_out(radius, friction, free, start, Touching.join(solids))
    last = len(motion.person.radius)
    on_person, on_seat = jnp.any(touched[:last], axis=0), jnp.any(touched[last:-1], axis=0)

    old, local = before.local(start), now.local(pos)

    def sweep(carry: tuple, crowd: Array) -> tuple[tuple, None]:
        local, contacts, on_vessel = carry
        local, contacts = push_pairs(radius, friction, local, old, contacts, crowd, h)
        local, touched = push_vessel(spec.vessel, radius, friction, local, old, h)
        return (local, contacts, on_vessel | touched), None

    crowds = jnp.array([EAGER] * (spec.sweeps - 1) + [CALM], jnp.float32)
    untouched = jnp.zeros(spec.count, bool)
    carry, _ = jax.lax.scan(sweep, (local, contacts, untouched), crowds, unroll=True)
    pushed, contacts, on_vessel = carry
    # from differences: exact where nothing pushes, and in float32 far from the origin
    pos = add(pos, turn(now.rot_w, sub(pushed, local)))
    vel = scale(1.0 - spec.damping * h, add(vel, scale(1.0 / h, sub(pos, free))))
    return pos, vel, contacts, (on_vessel, on_person, on_seat, touched[-1])


def _is_finite(pos: Array, vel: Array) -> Array:
    """Which particles have finite positions and velocities (n,)."""
    return jnp.isfinite(pos).all(-1) & jnp.isfinite(vel).all(-1)


def _interpolate(motion: Obstacles, substeps: int) -> _Moving:
    """What moves, at every substep: T moments become 1 + (T - 1) * substeps."""
    quat = motion.vessel_quat_w
    n_steps = len(quat) - 1
    flips = jnp.where(jnp.sum(quat[1:] * quat[:-1], -1) < 0, -1.0, 1.0)
    quat = quat * jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]
    share = jnp.arange(1, substeps + 1) / substeps

    def fill(x: Array) -> Array:
        part = share.reshape(-1, *[1] * (x.ndim - 1))
        between = x[:-1, None] + part * (x[1:] - x[:-1])[:, None]
        return jnp.concatenate([x[:1], between.reshape(n_steps * substeps, *x.shape[1:])])

    return _Moving(
        pos_w=fill(motion.vessel_pos_w),
        rot_w=rotation(fill(quat)),
        a_w=fill(motion.person.a_w),
        b_w=fill(motion.person.b_w),
    )
