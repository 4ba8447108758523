"""What the gown meets: the person's limbs, of which upper arm and forearm may taper, and the left armrest."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import shapes_of
from agym_jax.human.capsules import link_capsules

ARMREST = (
    ((0.245, -0.171, 0.685), (0.245, 0.025, 0.685)),
    ((0.298, -0.171, 0.685), (0.298, 0.025, 0.685)),
)
"""Ends of the armrest's two capsules, world [m]: assets/furniture/wheelchair.xml."""
ARMREST_RADIUS = 0.034  # [m]
TAPERING = ("left_upper_arm", "left_forearm")
AG_GRID = 0.25
"""Distance of the points between which AG's cloth interpolates how far it is from a limb [m] (btSparseSDF, voxelsz)."""


def obstacles(
    d: Dims, limbs: tuple[str, ...], pos_w: dict[str, Array], rot_w: dict[str, Array]
) -> tuple[Array, Array, Array]:
    """Return the k capsules of limbs and armrest at n moments; the limbs come first.

    Args:
        d: sizes of the person.
        limbs: names of the limbs.
        pos_w: limb -> its joint, world [m] (n, 3).
        rot_w: limb -> rotation matrix (n, 3, 3).

    Returns:
        both ends, world [m] (n, k, 3), and radii [m] (k,).
    """
    a, b, radius = link_capsules(d, limbs, pos_w, rot_w)
    still = jnp.broadcast_to(jnp.array(ARMREST), (len(a), 2, 2, 3))
    a, b = (jnp.concatenate([x, still[:, :, i]], 1) for i, x in enumerate((a, b)))
    return a, b, jnp.concatenate([radius, jnp.full(len(ARMREST), ARMREST_RADIUS)])


def arm_taper(limbs: Sequence[str], a_w: Array, b_w: Array) -> Array:
    """Return how much thinner AG's cloth finds upper arm and forearm at their ends than in the middle [m] (k,); 0 for others.

    Args:
        limbs: as for ``obstacles``.
        a_w: one end of each of its capsules at a moment, world [m] (k, 3).
        b_w: the other end, world [m] (k, 3).
    """
    arm = np.array([x in TAPERING for x in shapes_of(limbs)] + [False] * len(ARMREST))
    return jnp.where(arm, ag_taper(a_w, b_w), 0.0)


def ag_taper(a_w: Array, b_w: Array) -> Array:
    """Return how much thinner AG's cloth finds capsules at their ends than in the middle [m] (k,).

    Along the axis, AG's distance is linear from the centre, where it is minus the radius, to a point AG_GRID away.

    Args:
        a_w: one end of each capsule, at most 2 AG_GRID from the other, world [m] (k, 3).
        b_w: the other end, world [m] (k, 3).
    """
    half = jnp.linalg.norm(b_w - a_w, axis=-1) / 2
    return half * (1.0 - half / AG_GRID)
