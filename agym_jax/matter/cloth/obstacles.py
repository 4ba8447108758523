"""What the gown meets: the person's limbs, of which those of the left arm may be as AG's cloth finds them, and the left armrest."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import SHAPES, shapes_of
from agym_jax.human.capsules import link_capsules
from agym_jax.matter.cloth.grid import Grid

ARMREST = (
    ((0.245, -0.171, 0.685), (0.245, 0.025, 0.685)),
    ((0.298, -0.171, 0.685), (0.298, 0.025, 0.685)),
)
"""Ends of the armrest's two capsules, world [m]: assets/furniture/wheelchair.xml."""
ARMREST_RADIUS = 0.034  # [m]
ARM = ("left_upper_arm", "left_forearm", "left_hand")
"""Limbs that may be found as AG's cloth finds them."""
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
        joints: whether the joints of the arm have spheres, as where AG's cloth finds it.

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


def ag_grid(limbs: Sequence[str], rot_w: dict[str, Array], on: Array) -> Grid:
    """Return how AG's cloth finds the arm, among the ``obstacles`` with joints; a joint's sphere turns with the limb beyond it.

    Args:
        limbs: as for ``obstacles``.
        rot_w: limb -> rotation matrix at a moment (3, 3).
        on: 1 for an arm as AG's cloth finds it, 0 for capsules ().
    """
    parts = [x if x in ARM else None for x in shapes_of(limbs)] + [None] * len(ARMREST)
    parts += [limb for limb, _ in JOINTS]
    axes = [jnp.eye(3) if x is None else rot_w[x] for x in parts]
    which = tuple(i for i, x in enumerate(parts) if x is not None)
    return Grid(rot_w=jnp.stack(axes), on=on, which=which)


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
