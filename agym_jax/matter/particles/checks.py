"""Limits within which particles are simulated accurately, checked before anything runs."""

from __future__ import annotations

import math

from agym_jax.errors import AgymError
from agym_jax.matter.particles.containers import Vessel
from agym_jax.matter.particles.solver import ParticleSpec

PACKING = 0.5
"""Share of the volume that spheres may take up: loosely packed, they fill 0.55 of it."""
OPENING_RADII = 2.0
"""A vessel's wall stops particles that move by less than the width of its opening: by this many radii of it."""


class MatterError(AgymError, ValueError):
    """Particles that do not fit into their vessel, or move too far in a substep."""


def capacity(vessel: Vessel, radius: float) -> int:
    """How many spheres of a radius [m] a vessel holds: level with the rim, and half a layer above it."""
    volume = vessel.volume + vessel.mouth_area * radius
    return math.floor(PACKING * volume / (4 / 3 * math.pi * radius**3))


def speed_limit(spec: ParticleSpec, dt: float, thinnest: float) -> float:
    """Greatest speed [m/s] at which no particle passes through a solid or a wall in one substep.

    A particle leaves a solid on the nearest side, so it must not move beyond the solid's middle. The wall of the
    vessel remembers the side of each particle, and fails only for displacements across the whole opening.

    Args:
        spec: of the particles.
        dt: physics step [s].
        thinnest: least half thickness of the person's capsules and the furniture [m].
    """
    h = dt / spec.substeps
    return min(thinnest + spec.radius, OPENING_RADII * spec.vessel.brim[0]) / h


def check(spec: ParticleSpec, dt: float, thinnest: float = math.inf) -> None:
    """Refuse particles that could not be simulated accurately.

    Args:
        spec: of the particles.
        dt: physics step [s].
        thinnest: least half thickness of the person's capsules and the furniture [m].

    Raises:
        MatterError: no vessel, more particles than it holds, or substeps in which a particle could pass through
            a wall. The message names the limit.
    """
    if not isinstance(spec.vessel, Vessel):
        raise MatterError(
            f"{spec.count} particles need a vessel, got {spec.vessel!r}. Use a Cup or "
            "a Bowl of agym_jax.matter.particles.containers, such as CUP or SPOON."
        )
    numbers = {"count": spec.count, "radius": spec.radius, "mass": spec.mass, "dt": dt}
    numbers |= {"substeps": spec.substeps, "sweeps": spec.sweeps, "max_speed": spec.max_speed}
    for name, value in numbers.items():
        if not value > 0:
            raise MatterError(f"Particles need {name} > 0, got {value}.")
    most = capacity(spec.vessel, spec.radius)
    if spec.count > most:
        raise MatterError(
            f"{spec.count} particles of radius {spec.radius} m do not fit into a vessel of "
            f"{1e6 * spec.vessel.volume:.1f} cm^3: it holds {most}. Use fewer or smaller particles, or "
            "a larger vessel."
        )
    limit = speed_limit(spec, dt, thinnest)
    if spec.max_speed > limit:
        needed = math.ceil(spec.substeps * spec.max_speed / limit)
        raise MatterError(
            f"At {spec.max_speed} m/s a particle could cross a wall within one substep of "
            f"{1e3 * dt / spec.substeps:.2f} ms; the limit is {limit:.2f} m/s. Use substeps={needed} or "
            "more, or a lower max_speed."
        )
