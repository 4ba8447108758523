"""What the gown meets: the person's limbs, of which upper arm and forearm may taper, and the left armrest."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import SHAPES, shapes_of
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
AG_MARGIN = 0.04  # of AG's cloth around a limb [m]
CAPSULE, SPHERE = 0.82, 0.71
"""How far AG's cloth stays from a capsule's axis in its middle, and from the centre of a sphere, as shares of radius and margin (means over
all directions; 1 along the grid's axes)."""
ENDS = 0.79
"""Of ``ag_taper``, in the mean over all directions around the axis."""
JOINTS = (
    ("left_upper_arm", "left_upper_arm"),
    ("left_forearm", "left_upper_arm"),
    ("left_hand", "left_forearm"),
)
"""AG's spheres for the gown, at shoulder, elbow and wrist: at the joint of which limb, and as thick as which."""


def obstacles(
    d: Dims, limbs: tuple[str, ...], pos_w: dict[str, Array], rot_w: dict[str, Array], joints: bool = False,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the k capsules of limbs and armrest at n moments; the limbs come first, joints last.

    Args:
        d: sizes of the person.
        limbs: names of the limbs.
        pos_w: limb -> its joint, world [m] (n, 3).
        rot_w: limb -> rotation matrix (n, 3, 3).
        joints: whether the joints of the arm have spheres, which matters only where its limbs taper.

    Returns:
        both ends, world [m] (n, k, 3), and radii [m] (k,).
    """
    a, b, radius = link_capsules(d, limbs, pos_w, rot_w)
    still = jnp.broadcast_to(jnp.array(ARMREST), (len(a), 2, 2, 3))
    more = [pos_w[joint][:, None] for joint, _ in JOINTS] if joints else []
    a, b = (jnp.concatenate([x, still[:, :, i], *more], 1) for i, x in enumerate((a, b)))
    which = [shapes_of(limbs).index(limb) for _, limb in JOINTS] if joints else []
    thick = [radius[limb][None] for limb in which]
    return a, b, jnp.concatenate([radius, jnp.full(len(ARMREST), ARMREST_RADIUS), *thick])


def ag_radii(limbs: Sequence[str], radius: Array, thickness: float) -> Array:
    """Return the radii of the obstacles [m] (k,), those of the arm as AG's cloth finds them.

    Args:
        limbs: as for ``obstacles``.
        radius: from ``obstacles``, with joints [m] (k,).
        thickness: of the cloth, which stays so far away [m].
    """
    shares = dict.fromkeys(TAPERING, CAPSULE) | {"left_hand": SPHERE}
    share = [shares.get(x, 0.0) for x in shapes_of(limbs)] + [0.0] * len(ARMREST)
    share = np.array(share + [SPHERE] * len(JOINTS))
    return jnp.where(share > 0, share * (radius + AG_MARGIN) - thickness, radius)


def on_limbs(total: Array, limbs: Sequence[str], joints: bool) -> Array:
    """Return the force on each limb [N] (len(limbs),): on all its shapes, and on the spheres that are as thick as it.

    Args:
        total: on each obstacle [N] (k,).
        limbs: as for ``obstacles``.
        joints: as for ``obstacles``.
    """
    pressed = [limbs.index(SHAPES[x]) for x in shapes_of(limbs)] + [len(limbs)] * len(ARMREST)
    pressed += [limbs.index(limb) for _, limb in JOINTS] if joints else []
    own = np.array(pressed) == np.arange(len(limbs))[:, None]
    return jnp.where(own, total, 0.0).sum(-1)


def tapering(
    limbs: Sequence[str], a_w: Array, b_w: Array, radius: Array, thickness: float, tapered: Array
) -> tuple[Array, Array]:
    """Return the obstacles' radii in the middle, and how much thinner they are at their ends [m], each (k,).

    Args:
        limbs: as for ``obstacles``.
        a_w: one end of each of its obstacles at a moment, with joints, world [m] (k, 3).
        b_w: the other end, world [m] (k, 3).
        radius: of them [m] (k,).
        thickness: of the cloth, which stays so far away [m].
        tapered: 1 for an arm as AG's cloth finds it, 0 for capsules ().
    """
    thinner = ag_radii(limbs, radius, thickness)
    arm = np.array([x in TAPERING for x in shapes_of(limbs)])
    arm = np.pad(arm, (0, len(a_w) - len(arm)))
    taper = jnp.where(arm, tapered * ENDS * ag_taper(a_w, b_w), 0.0)
    return jnp.where(tapered > 0.0, thinner, radius), taper


def ag_taper(a_w: Array, b_w: Array) -> Array:
    """Return how much thinner AG's cloth finds capsules at their ends than in the middle [m] (k,).

    Along the axis, AG's distance is linear from the centre, where it is minus the radius, to a point AG_GRID away.

    Args:
        a_w: one end of each capsule, at most 2 AG_GRID from the other, world [m] (k, 3).
        b_w: the other end, world [m] (k, 3).
    """
    half = jnp.linalg.norm(b_w - a_w, axis=-1) / 2
    return half * (1.0 - half / AG_GRID)
