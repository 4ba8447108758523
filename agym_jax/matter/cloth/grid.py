"""How AG's cloth finds limbs: by distances that are known at the points of a grid, and linear between them.

Bullet's soft bodies read the distance from a solid off a grid in its frame, whose points are 0.25 m apart (``btSparseSDF``), and
interpolate between the eight points around a vertex. Around the middle of a limb, where a point of the grid is, surfaces become
diamonds: a sphere is an octahedron, as thick as the sphere along the grid's axes and 0.58 times as thick in the diagonals, and a
capsule has a square cross-section and becomes thinner towards its ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import Array
from jax.lax import rsqrt

from agym_jax.matter.shapes import TINY, Xyz, dot, map_xyz, scale

SPACING = 0.25
"""Distance of the grid's points [m]: btSparseSdf.h, voxelsz."""
MARGIN = 0.04
"""How far AG's cloth stays away by these distances [m]: dressing.py, collisionMargin."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Grid:
    """Which of k capsules the cloth finds by a grid around their middle; capsules are along its z axis."""

    rot_w: Array  # axes of each capsule's grid, in its columns             (k, 3, 3)
    on: Array  # 1: by the grid, 0: as a capsule                            ()
    which: tuple[int, ...] = field(metadata={"static": True})
    """Capsules that may be found so."""


def interpolated(local: Xyz, half: Array) -> tuple[Array, Xyz, Array]:
    """Return AG's distance from the axis of a capsule, its direction of steepest ascent, and whether the grid's inner cells have the point.

    Args:
        local: points seen from the middle of the capsule, in the frame of its grid [m], each (n,).
        half: half the length of the axis, along z, less than SPACING [m].

    Returns:
        distance from the axis [m] (n,), a unit vector in the frame of the grid, each (n,), and bool (n,).
    """
    u, v, w = map_xyz(lambda x: jnp.abs(x) / SPACING, local)
    above = jnp.maximum(SPACING - half, 0.0)  # from the end of the axis to the next point on it
    side, diagonal = SPACING, 2.0**0.5 * SPACING
    side_above, diagonal_above = (jnp.sqrt(x * x + above * above) for x in (side, diagonal))
    level = _bilinear(0.0, side, diagonal, u, v)
    higher = _bilinear(above, side_above, diagonal_above, u, v)

    def along(other: Array) -> Array:
        """Slope along x or y, times SPACING, at a place along the other one."""
        low = side + (diagonal - 2.0 * side) * other
        high = (side_above - above) + (diagonal_above - 2.0 * side_above + above) * other
        return low + (high - low) * w

    slopes = along(v), along(u), higher - level
    x, y, z = (jnp.where(at < 0.0, -s, s) for at, s in zip(local, slopes, strict=True))
    slopes = x, y, z
    steepest = scale(rsqrt(jnp.maximum(dot(slopes, slopes), TINY)), slopes)
    return level + (higher - level) * w, steepest, jnp.maximum(jnp.maximum(u, v), w) < 1.0


def _bilinear(
    corner: float | Array, side: float | Array, diagonal: float | Array, u: Array, v: Array
) -> Array:
    """Interpolate between a corner of a square, its two neighbours, which are alike, and the opposite corner."""
    return corner + (side - corner) * (u + v) + (diagonal - 2.0 * side + corner) * u * v
