"""The person as capsules in the world: what food and water meet."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import SHAPES, shape, shapes_of


def link_capsules(
    d: Dims, links: tuple[str, ...], pos_w: Mapping[str, Array], rot_w: Mapping[str, Array]
) -> tuple[Array, Array, Array]:
    """The k collision shapes of links, the same that MuJoCo has; a sphere is a capsule of no length.

    Args:
        d: sizes of the person.
        links: names; the head has several shapes, see ``body.shapes_of``.
        pos_w: link -> its (last) joint, world [m] (..., 3).
        rot_w: link -> rotation matrix (..., 3, 3).

    Returns:
        both ends [m] (..., k, 3) and radii [m] (k,).
    """
    ends: tuple[list, list] = ([], [])
    radii = []
    for name in shapes_of(links):
        s, link = shape(name, d), SHAPES[name]
        axis = jnp.array([s.axis == x for x in "xyz"], jnp.float32)  # 0 for a sphere
        centre = jnp.stack([jnp.asarray(x, jnp.float32) for x in s.centre])
        for side, out in zip((-1.0, 1.0), ends, strict=True):
            out.append(pos_w[link] + rot_w[link] @ (centre + side * s.length / 2 * axis))
        radii.append(jnp.asarray(s.radius, jnp.float32))
    return jnp.stack(ends[0], -2), jnp.stack(ends[1], -2), jnp.stack(radii)
