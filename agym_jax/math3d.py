"""Distances between capsules, in closed form."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

Capsules = tuple[Array, Array, Array]
"""Centres [m] (n, 3), half axes [m] (n, 3) (0 for spheres), radii [m] (n,)."""


def capsule_gap(a: Capsules, b: Capsules) -> Array:
    """Least distance between two sets of capsules; negative inside [m] ().

    Args:
        a: m capsules.
        b: n capsules.
    """
    if not len(a[2]) or not len(b[2]):
        return jnp.float32(jnp.inf)
    centre, other = a[0][:, None], b[0][None]
    u, v = a[1][:, None], b[1][None]
    apart = segment_distance(centre - other, u, v)
    return jnp.min(apart - a[2][:, None] - b[2][None])


def segment_distance(between: Array, u: Array, v: Array) -> Array:
    """Distance of the segments ``+-u`` and ``+-v`` whose centres are ``between`` apart [m] (...).

    The closest points are where both parameters are optimal in [-1, 1]: one is solved for with the
    other free, clipped, and then each given the other.

    Args:
        between: first centre minus second [m] (..., 3).
        u: half axis of the first [m] (..., 3).
        v: half axis of the second [m] (..., 3).
    """
    uu, vv, uv = (jnp.sum(x * y, -1) for x, y in ((u, u), (v, v), (u, v)))
    ub, vb = jnp.sum(u * between, -1), jnp.sum(v * between, -1)
    tiny = 1e-12
    s = jnp.clip((uv * vb - vv * ub) / jnp.maximum(uu * vv - uv * uv, tiny), -1.0, 1.0)
    t = jnp.clip((vb + s * uv) / jnp.maximum(vv, tiny), -1.0, 1.0)
    s = jnp.clip((t * uv - ub) / jnp.maximum(uu, tiny), -1.0, 1.0)
    return jnp.linalg.norm(between + s[..., None] * u - t[..., None] * v, axis=-1)
