"""Food and water: spheres moved by position-based dynamics, one environment, beside MJX.

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
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.math3d import rotation_rows, unit_quat_parts
from agym_jax.matter.fused_scan import SumOver, fused_scan, pad_to_power_of_two
from agym_jax.matter.particles.constraints import (
    CALM,
    EAGER,
    push_out,
    push_pairs,
    push_vessel,
    solid_pushes,
)
from agym_jax.matter.particles.containers import CUP, SPOON, Vessel
from agym_jax.matter.shapes import (
    Boxes,
    Capsules,
    Ends,
    Quat,
    Xyz,
    add,
    boxes_touching,
    capsules_touching,
    columns,
    each,
    floor_touching,
    length,
    quat_columns,
    scale,
    sub,
    turn,
    turn_back,
)

AWAY = 100.0
"""Masked particles are computed this far from each other and from everything [m]."""
NOWHERE = -1e6
"""Sizes and coordinates of solids that are not there [m]."""


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
    human: Capsules  # ends (T?, k, 3), radii (k,)
    furniture: Boxes  # at rest
    floor: Array  # height [m]                                              ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """What every particle touched in the last physics step; masked ones touch nothing."""

    vessel: Array  # (n,) bool
    human: Array  # (n,) bool
    furniture: Array  # (n,) bool
    floor: Array  # (n,) bool
    lost: Array  # that went non-finite on the whole way and were masked    () int32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Moving:
    """The obstacles that move, at one substep; over all of them with a leading axis."""

    pos_w: Xyz  # of the vessel                                             each ()
    rot_w: tuple[Xyz, Xyz, Xyz]  # rows, of the vessel                      each ()
    ends_w: Ends  # of the person's capsules                                each (k,)

    def local(self, pos_w: Xyz) -> Xyz:
        """In the vessel's frame, from the world [m], each (n,)."""
        return turn_back(self.rot_w, sub(pos_w, self.pos_w))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Still:
    """What does not change from substep to substep."""

    radius: Array  # of the person's capsules                               (k,)
    furniture: tuple[Xyz, Quat, Xyz]  # as Boxes.columns                    each (b,)
    floor: Array  # height [m]                                              ()


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
    human = replace(
        end.human,
        a_w=pair(start.human.a_w, end.human.a_w),
        b_w=pair(start.human.b_w, end.human.b_w),
    )
    motion = replace(
        end,
        vessel_pos_w=pair(start.vessel_pos_w, end.vessel_pos_w),
        vessel_quat_w=pair(start.vessel_quat_w, end.vessel_quat_w),
        human=human,
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
    radius, furniture = jax.tree.map(_pad, (motion.human.radius, motion.furniture.columns()))
    still = _Still(radius, furniture, motion.floor)
    local, alone = jax.tree.map(lambda x: x[0], moments).local(pos), jnp.zeros(spec.count)
    _, contacts = push_pairs(spec.radius, spec.friction, local, local, alone, CALM, h)
    unseen = (jnp.zeros(spec.count, bool),) * 4
    carry = fused_scan(partial(_substep, spec, h), (pos, vel, contacts, unseen), moments, still)
    (pos, vel), seen = (jnp.stack(x, -1) for x in carry[:2]), carry[-1]
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
    spec: ParticleSpec, h: float, carry: tuple, number: Array, before: _Moving, now: _Moving, still: _Still,
    sum_over: SumOver,
) -> tuple:  # fmt: skip
    """One substep of length h [s].

    Args:
        spec: of the particles.
        h: its length [s].
        carry: positions, velocities, contacts with others, and what was touched in the physics step.
        number: how many substeps were before.
        before: what moves, at its beginning.
        now: what moves, at its end.
        still: what does not.
        sum_over: how to sum over solids, and over other particles.

    Returns:
        the same as ``carry``, afterwards.
    """
    (start, vel, contacts, seen), radius, friction = carry, spec.radius, spec.friction
    vel = (vel[0], vel[1], vel[2] + spec.gravity * h)
    vel = scale(jnp.minimum(1.0, spec.max_speed / length(vel)), vel)
    free = add(start, scale(h, vel))

    pushes = partial(solid_pushes, radius, friction, free, start)
    capsules = now.ends_w, before.ends_w, still.radius
    groups = (
        sum_over(lambda x: pushes(capsules_touching(free, *x)), capsules),
        sum_over(lambda x: pushes(boxes_touching(free, *x)), still.furniture),
        sum_over(lambda x: pushes(floor_touching(free, x)), still.floor),
    )
    pos = push_out(free, groups)

    old, local = before.local(start), now.local(pos)
    pushed, on_vessel = local, jnp.zeros(spec.count, bool)
    for crowd in (EAGER,) * (spec.sweeps - 1) + (CALM,):
        pushed, contacts = push_pairs(radius, friction, pushed, old, contacts, crowd, h, sum_over)
        pushed, touched = push_vessel(spec.vessel, radius, friction, pushed, old, h)
        on_vessel = on_vessel | touched
    # from differences: exact where nothing pushes, and in float32 far from the origin
    pos = add(pos, turn(now.rot_w, sub(pushed, local)))
    vel = scale(1.0 - spec.damping * h, add(vel, scale(1.0 / h, sub(pos, free))))
    goes_on = jax.lax.rem(number, spec.substeps) != 0  # the physics step has begun before
    touched = (on_vessel, *(count > 0 for _, count in groups))
    seen = tuple((a & goes_on) | b for a, b in zip(seen, touched, strict=True))
    return pos, vel, contacts, seen


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
        pos_w=each(fill, columns(motion.vessel_pos_w)),
        rot_w=rotation_rows(*unit_quat_parts(*quat_columns(fill(quat)))),
        ends_w=jax.tree.map(lambda x: fill(_pad(x)), motion.human.ends()),
    )


_pad = partial(pad_to_power_of_two, value=NOWHERE)
