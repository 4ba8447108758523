"""Rotations, quaternions and distances between capsules.

Quaternions are wxyz. Functions take any number of leading axes and, where they have an argument ``xp``, work on
NumPy or on JAX arrays. ``xp`` is ``jax.numpy`` unless it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

Array = Any
Row = tuple[Array, Array, Array]
"""The three entries of one row of matrices."""
CentredCapsules = tuple[Array, Array, Array]
"""Centres [m] (n, 3), half axes [m] (n, 3) (0 for spheres), radii [m] (n,)."""

TINY = 1e-12
"""Least squared length: square roots and quotients stay finite and differentiable."""


def split(x: Array) -> Sequence[Array]:
    """The entries of vectors (..., n), each (...); of a single one in NumPy as scalars, which are faster."""
    if isinstance(x, np.ndarray) and x.ndim == 1:
        return tuple(x)
    return [x[..., i] for i in range(x.shape[-1])]


def joined(parts: Sequence[Array], xp: Any = jnp) -> Array:
    """Vectors (..., n) of their entries, each (...); NumPy's ``stack`` takes eight times as long for a few numbers."""
    if xp is np and np.ndim(parts[0]) == 0:
        return np.array(parts)
    return xp.stack([xp.asarray(x) for x in parts], -1)


def quat_mul(a: Array, b: Array, xp: Any = jnp) -> Array:
    """Product of quaternions: the rotation ``b``, then ``a`` (..., 4).

    Args:
        a: (..., 4).
        b: (..., 4).
        xp: numpy or jax.numpy.
    """
    aw, ax, ay, az = split(a)
    bw, bx, by, bz = split(b)
    return joined([
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ], xp)  # fmt: skip


def axis_angle_quat(axis: Array, angle: Array, xp: Any = jnp) -> Array:
    """Quaternions (..., 4) of rotations about unit axes (..., 3) by angles [rad] (...)."""
    if xp is np and np.ndim(angle) == 0 and np.ndim(axis) == 1:
        half = angle / 2
        return joined([np.cos(half), *(np.sin(half) * axis)], np)
    half = xp.asarray(angle)[..., None] / 2
    return xp.concatenate([xp.cos(half), xp.sin(half) * axis], -1)


def first_sign(quat: Array) -> Array:
    """Quaternions (..., 4) with the sign that Bullet's ``btMatrix3x3::getRotation`` gives them.

    w is positive where the rotation matrix has a positive trace (w * w > 1 / 4); elsewhere the greatest of x, y, z is.
    """
    w, xyz = quat[..., :1], quat[..., 1:]
    greatest = jnp.take_along_axis(xyz, jnp.argmax(xyz * xyz, -1, keepdims=True), -1)
    return jnp.where(jnp.where(w * w > 0.25, w, greatest) < 0, -quat, quat)


def nearest_sign(quat: Array, before: Array) -> Array:
    """Quaternions (..., 4) with the sign that is nearer to those ``before`` (..., 4)."""
    return jnp.where(jnp.sum(quat * before, -1, keepdims=True) < 0, -quat, quat)


def rotate(quat: Array, vectors: Array, xp: Any = jnp) -> Array:
    """Vectors (..., 3) rotated by unit quaternions (..., 4)."""
    return _rotate(quat[..., :1], quat[..., 1:], vectors, xp)


def rotate_inverse(quat: Array, vectors: Array, xp: Any = jnp) -> Array:
    """Vectors (..., 3) rotated by the inverses of unit quaternions (..., 4)."""
    return _rotate(quat[..., :1], -quat[..., 1:], vectors, xp)


def cross(a: Array, b: Array, xp: Any = jnp) -> Array:
    """Cross product of vectors (..., 3); NumPy's own takes four times as long for a single pair."""
    if xp is jnp:
        return jnp.cross(a, b)
    ax, ay, az = split(a)
    bx, by, bz = split(b)
    return joined([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], xp)


def _rotate(w: Array, u: Array, vectors: Array, xp: Any) -> Array:
    t = 2.0 * cross(u, vectors, xp)
    return vectors + w * t + cross(u, t, xp)


def unit_quat_parts(w: Array, x: Array, y: Array, z: Array, xp: Any = jnp) -> tuple[Array, ...]:
    """Parts of quaternions, each (...), divided by the quaternions' lengths."""
    size = xp.sqrt(xp.maximum(w * w + x * x + y * y + z * z, TINY))
    return w / size, x / size, y / size, z / size


def rotation_rows(w: Array, x: Array, y: Array, z: Array) -> tuple[Row, Row, Row]:
    """Rows of the rotation matrices of unit quaternions, from their parts; all entries (...)."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def rotation_matrix(quat: Array, xp: Any = jnp, *, normalize: bool = False) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4).

    Args:
        quat: of unit length, unless it is normalized here.
        xp: numpy or jax.numpy.
        normalize: divide by the length first.
    """
    w, x, y, z = (quat[..., i] for i in range(4))
    if normalize:
        w, x, y, z = unit_quat_parts(w, x, y, z, xp)
    return xp.stack([xp.stack(row, -1) for row in rotation_rows(w, x, y, z)], -2)


def axis_angle_matrix(axis: Array, angle: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation about a unit axis (3,) by an angle [rad] ()."""
    x, y, z = axis
    zero = jnp.zeros_like(x)
    k = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    return jnp.eye(3) + jnp.sin(angle) * k + (1.0 - jnp.cos(angle)) * (k @ k)


def rotation_error(rot: Array, goal: Array) -> Array:
    """Rotation vector [rad] (3,) from ``rot`` to ``goal``, both (3, 3), in their parent frame."""
    m = goal @ rot.T
    skew = jnp.stack([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2
    sin = jnp.linalg.norm(skew + 1e-12)
    angle = jnp.arctan2(sin, (jnp.trace(m) - 1) / 2)
    return skew / sin * angle


def child_quat(quat: Array, local: Array, xp: Any = jnp) -> Array:
    """Orientation (..., 4) of a frame that is fixed in another.

    The same rotation as ``quat_mul(quat, local)``. This function and ``child_pose`` keep their orders of operations,
    which differ in the last bit, because trajectories are compared bit for bit between versions.

    Args:
        quat: of the other frame (..., 4).
        local: of the fixed frame in the other (4,).
        xp: numpy or jax.numpy.
    """
    local = xp.asarray(local, xp.float32)
    inner = xp.vecdot(quat[..., 1:], local[1:])[..., None]
    return _child_quat(quat, local, inner, xp)


def child_pose(pos: Array, quat: Array, local_pos: Any, local_quat: Any) -> tuple[Array, Array]:
    """Pose of a frame that is fixed in another: position [m] (..., 3), orientation (..., 4).

    Args:
        pos: of the other frame [m] (..., 3).
        quat: of the other frame (..., 4).
        local_pos: of the fixed frame in the other [m] (3,).
        local_quat: of the fixed frame in the other (4,).
    """
    w, v = quat[..., :1], quat[..., 1:]
    offset = jnp.broadcast_to(jnp.asarray(local_pos, jnp.float32), v.shape)
    t = 2.0 * jnp.cross(v, offset)
    local = jnp.asarray(local_quat, jnp.float32)
    inner = jnp.sum(v * local[1:], -1, keepdims=True)
    return pos + offset + w * t + jnp.cross(v, t), _child_quat(quat, local, inner, jnp)


def _child_quat(quat: Array, local: Array, inner: Array, xp: Any) -> Array:
    """The product, given the inner product of the vector parts (..., 1)."""
    (w, v), (b, c) = (quat[..., :1], quat[..., 1:]), (local[0], local[1:])
    return xp.concatenate([w * b - inner, w * c + b * v + xp.cross(v, c)], -1)


def capsule_gap(a: CentredCapsules, b: CentredCapsules) -> Array:
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
    s = jnp.clip((uv * vb - vv * ub) / jnp.maximum(uu * vv - uv * uv, TINY), -1.0, 1.0)
    t = jnp.clip((vb + s * uv) / jnp.maximum(vv, TINY), -1.0, 1.0)
    s = jnp.clip((t * uv - ub) / jnp.maximum(uu, TINY), -1.0, 1.0)
    return jnp.linalg.norm(between + s[..., None] * u - t[..., None] * v, axis=-1)
