"""Food and water: spheres moved by position-based dynamics, in one environment, beside MJX.

In every substep the particles fall freely, are moved out of the person, the furniture and the floor,
and then, in the moving frame of the vessel, a few Jacobi sweeps move them out of each other and of the
vessel's wall (``constraints.py``). Velocities follow from positions, so collisions are inelastic (restitution 0,
as in AG); penetrations of earlier substeps are removed slowly, so that they never turn into bounces.

A particle cannot change the side of the vessel's wall within a substep, however fast it or the vessel
moves: its path from old to new position, in the vessel's frame, either passes through the opening or is
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
    LAST_RELAXATION,
    RELAXATION,
    apply_pairs,
    apply_solids,
    apply_vessel,
    solid_corrections,
)
from agym_jax.matter.particles.containers import CUP, SPOON, Vessel
from agym_jax.matter.shapes import (
    Boxes,
    Capsules,
    Ends,
    Quat,
    Xyz,
    add,
    box_distances,
    capsule_distances,
    columns,
    floor_distances,
    length,
    map_xyz,
    matvec,
    matvec_transposed,
    quat_columns,
    scale,
    sub,
)

MASKED_SPACING = 100.0
"""Masked particles are computed this far from each other and from everything else [m]."""
PADDING = -1e6
"""Sizes and coordinates of the solids that pad arrays to a power of two [m]."""


@dataclass(frozen=True)
class ParticleSpec:
    """The particles of a task, the vessel that holds them, and the settings of their solver.

    Attributes:
        vessel: holds the particles.
        count: n, number of particles.
        radius: of a particle [m].
        mass: of a particle [kg].
        friction: coefficient, with solids and with each other.
        damping: of velocities [1/s].
        gravity: along world z [m/s^2].
        substeps: per physics step.
        sweeps: Jacobi sweeps per substep.
        max_speed: bound on the speed of a particle [m/s].
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
"""AG feeding.py reset: 2 x 2 x 2 spheres. Substeps of 3.3 ms in physics steps of 10 ms."""
WATER = ParticleSpec(CUP, count=64, substeps=4)
"""AG drinking.py reset: 4 x 4 x 4 spheres, a taller heap. Substeps of 2.5 ms in physics steps of 10 ms."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Particles:
    """State of n particles."""

    pos_w: Array  # centres [m]                                             (n, 3)
    vel_w: Array  # [m/s]                                                   (n, 3)
    alive: Array  # False once captured, spilled away or lost               (n,) bool

    def remove(self, mask: Array) -> Particles:
        """Mask the particles of a mask (n,): they stay where they were."""
        return replace(self, alive=self.alive & ~mask)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Obstacles:
    """What particles can touch. In a trajectory, what moves has a leading axis T."""

    vessel_pos_w: Array  # [m]                                              (T?, 3)
    vessel_quat_w: Array  # wxyz                                            (T?, 4)
    human: Capsules  # ends (T?, k, 3), radii (k,)
    furniture: Boxes  # at rest
    floor: Array  # height [m]                                              ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """What each particle touched in the last physics step; masked ones touch nothing."""

    vessel: Array  # (n,) bool
    human: Array  # (n,) bool
    furniture: Array  # (n,) bool
    floor: Array  # (n,) bool
    lost: Array  # particles masked because they became non-finite         () int32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Moving:
    """The obstacles that move, at the end of one substep; as a trajectory with a leading axis."""

    pos_w: Xyz  # of the vessel                                             each ()
    rot_w: tuple[Xyz, Xyz, Xyz]  # rows, of the vessel                      each ()
    ends_w: Ends  # of the person's capsules                                each (k,)

    def local(self, pos_w: Xyz) -> Xyz:
        """Points in the vessel's frame, from the world frame [m], each (n,)."""
        return matvec_transposed(self.rot_w, sub(pos_w, self.pos_w))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Constants:
    """What is the same in all substeps."""

    radius: Array  # of the person's capsules                               (k,)
    furniture: tuple[Xyz, Quat, Xyz]  # as Boxes.columns                    each (b,)
    floor: Array  # height [m]                                              ()


def step(
    spec: ParticleSpec, particles: Particles, start: Obstacles, end: Obstacles, dt: float
) -> tuple[Particles, Contact]:
    """Advance by one physics step.

    Args:
        spec: of the particles.
        particles: n particles.
        start: obstacles at the beginning of the step.
        end: obstacles at its end.
        dt: length of the step [s].
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
        particles: n particles.
        motion: obstacles; what moves has a leading axis T: at the beginning and after each step.
        dt: length of one physics step [s].

    Returns:
        particles, and what they touched in the last physics step.
    """
    h = dt / spec.substeps
    alive = particles.alive & _is_finite(particles.pos_w, particles.vel_w)
    masked = MASKED_SPACING * jnp.arange(1.0, spec.count + 1.0)
    pos = tuple(jnp.where(alive, x, masked) for x in columns(particles.pos_w))
    vel = tuple(jnp.where(alive, x, 0.0) for x in columns(particles.vel_w))

    trajectory = _interpolate(motion, spec.substeps)
    radius, furniture = jax.tree.map(_pad, (motion.human.radius, motion.furniture.columns()))
    constants = _Constants(radius, furniture, motion.floor)
    local, none = jax.tree.map(lambda x: x[0], trajectory).local(pos), jnp.zeros(spec.count)
    _, contacts = apply_pairs(spec.radius, spec.friction, local, local, none, LAST_RELAXATION, h)
    carry = pos, vel, contacts, (jnp.zeros(spec.count, bool),) * 4
    carry = fused_scan(partial(_substep, spec, h), carry, trajectory, constants)
    (pos, vel), touched = (jnp.stack(x, -1) for x in carry[:2]), carry[-1]
    moves = alive & _is_finite(pos, vel)
    kept = jnp.where(jnp.isfinite(particles.pos_w), particles.pos_w, 0.0)
    moved = Particles(
        pos_w=jnp.where(moves[:, None], pos, kept),
        vel_w=jnp.where(moves[:, None], vel, 0.0),
        alive=moves,
    )
    lost = jnp.sum(particles.alive & ~moves, dtype=jnp.int32)
    return moved, Contact(*(t & moves for t in touched), lost=lost)


def _substep(
    spec: ParticleSpec, h: float, carry: tuple, number: Array, start: _Moving, end: _Moving, constants: _Constants,
    sum_over: SumOver,
) -> tuple:  # fmt: skip
    """One substep of length h [s].

    Args:
        spec: of the particles.
        h: length of the substep [s].
        carry: positions [m], velocities [m/s], numbers of contacts between particles, and what each particle
            has touched in this physics step (vessel, person, furniture, floor).
        number: of the substep, counted from 0.
        start: obstacles that move, at the beginning of the substep.
        end: obstacles that move, at its end.
        constants: what does not move.
        sum_over: sums over solids, and over other particles.

    Returns:
        the carry after the substep.
    """
    (before, vel, contacts, touched_before), radius, friction = carry, spec.radius, spec.friction
    vel = (vel[0], vel[1], vel[2] + spec.gravity * h)
    vel = scale(jnp.minimum(1.0, spec.max_speed / length(vel)), vel)
    free = add(before, scale(h, vel))

    corrections = partial(solid_corrections, radius, friction, free, before)
    capsules = end.ends_w, start.ends_w, constants.radius
    groups = (
        sum_over(lambda x: corrections(capsule_distances(free, *x)), capsules),
        sum_over(lambda x: corrections(box_distances(free, *x)), constants.furniture),
        sum_over(lambda x: corrections(floor_distances(free, x)), constants.floor),
    )
    pos = apply_solids(free, groups)

    old, local = start.local(before), end.local(pos)
    new, on_vessel = local, jnp.zeros(spec.count, bool)
    for relaxation in (RELAXATION,) * (spec.sweeps - 1) + (LAST_RELAXATION,):
        new, contacts = apply_pairs(radius, friction, new, old, contacts, relaxation, h, sum_over)
        new, on_wall = apply_vessel(spec.vessel, radius, friction, new, old, h)
        on_vessel = on_vessel | on_wall
    # from differences: exact without corrections, and accurate in float32 far from the origin
    pos = add(pos, matvec(end.rot_w, sub(new, local)))
    vel = scale(1.0 - spec.damping * h, add(vel, scale(1.0 / h, sub(pos, free))))
    same_step = jax.lax.rem(number, spec.substeps) != 0  # as the substep before
    touching = (on_vessel, *(count > 0 for _, count in groups))
    touched = tuple((a & same_step) | b for a, b in zip(touched_before, touching, strict=True))
    return pos, vel, contacts, touched


def _is_finite(pos: Array, vel: Array) -> Array:
    """Which particles have finite positions and velocities (n,)."""
    return jnp.isfinite(pos).all(-1) & jnp.isfinite(vel).all(-1)


def _interpolate(motion: Obstacles, substeps: int) -> _Moving:
    """Trajectory of what moves: T poses become 1 + (T - 1) * substeps."""
    quat = motion.vessel_quat_w
    n_steps = len(quat) - 1
    flips = jnp.where(jnp.sum(quat[1:] * quat[:-1], -1) < 0, -1.0, 1.0)
    quat = quat * jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]
    share = jnp.arange(1, substeps + 1) / substeps

    def interpolate(x: Array) -> Array:
        part = share.reshape(-1, *[1] * (x.ndim - 1))
        between = x[:-1, None] + part * (x[1:] - x[:-1])[:, None]
        return jnp.concatenate([x[:1], between.reshape(n_steps * substeps, *x.shape[1:])])

    return _Moving(
        pos_w=map_xyz(interpolate, columns(motion.vessel_pos_w)),
        rot_w=rotation_rows(*unit_quat_parts(*quat_columns(interpolate(quat)))),
        ends_w=jax.tree.map(lambda x: interpolate(_pad(x)), motion.human.ends()),
    )


_pad = partial(pad_to_power_of_two, value=PADDING)
