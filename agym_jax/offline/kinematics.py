"""Serial chains in JAX: forward kinematics, Jacobian and batched inverse kinematics.

Written for one chain and one pose; use ``jax.vmap`` over targets, restarts or bases. Used as a reference in tests and
for scripted motions; placement banks are built with ``bullet_ik``, which reads the same chains.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from agym_jax.errors import SpecError
from agym_jax.math3d import axis_angle_matrix, rotation_error, rotation_matrix


@dataclass(frozen=True)
class Chain:
    """Hinges in series from a base to a site, read from a compiled model.

    Attributes:
        pos: position of each joint's frame in the one before [m] (n, 3).
        rot: its rotation matrix (n, 3, 3).
        axis: of each hinge in its own frame (n, 3).
        tip_pos: position of the site in the last frame [m] (3,).
        tip_rot: its rotation matrix (3, 3).
        lower: joint limits [rad] (n,).
        upper: joint limits [rad] (n,).
    """

    pos: np.ndarray
    rot: np.ndarray
    axis: np.ndarray
    tip_pos: np.ndarray
    tip_rot: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def chain_of(model: mujoco.MjModel, joints: np.ndarray, site: int, base: int) -> Chain:
    """The chain of hinges that ends at a site.

    Args:
        model: compiled model.
        joints: joint ids from the base outwards (n,).
        site: site id.
        base: body id; poses are relative to its frame.

    Raises:
        SpecError: a joint is not a hinge, or not between base and site.
    """
    path, b = [], int(model.site_bodyid[site])
    while b != base:
        if b == 0:
            raise SpecError(
                f"Site {model.site(site).name!r} does not hang on body {model.body(base).name!r}."
            )
        path.append(b)
        b = int(model.body_parentid[b])
    rows: dict[str, list] = {"pos": [], "rot": [], "axis": []}
    pos, rot = np.zeros(3), np.eye(3)
    wanted = [int(j) for j in joints]
    for b in reversed(path):
        pos = pos + rot @ model.body_pos[b]
        rot = rot @ rotation_matrix(model.body_quat[b], np)
        for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
            if j not in wanted:
                continue
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
                raise SpecError(f"Joint {model.joint(j).name!r} is not a hinge.")
            anchor = pos + rot @ model.jnt_pos[j]
            rows["pos"].append(anchor)
            rows["rot"].append(rot)
            rows["axis"].append(np.array(model.jnt_axis[j]))
            pos, rot = -model.jnt_pos[j], np.eye(3)
    if len(rows["pos"]) != len(wanted):
        raise SpecError(f"{len(wanted) - len(rows['pos'])} joints are not between base and site.")
    tip_pos = pos + rot @ model.site_pos[site]
    tip_rot = rot @ rotation_matrix(model.site_quat[site], np)
    limits = model.jnt_range[wanted]
    joint_pos, joint_rot, axis = (np.array(rows[k], np.float32) for k in ("pos", "rot", "axis"))
    return Chain(
        joint_pos, joint_rot, axis,
        tip_pos.astype(np.float32), tip_rot.astype(np.float32),
        limits[:, 0].astype(np.float32), limits[:, 1].astype(np.float32),
    )  # fmt: skip


def forward(chain: Chain, angles: Array) -> tuple[Array, Array, Array]:
    """Pose of the tip in the base frame, and its Jacobian.

    Args:
        chain: n hinges.
        angles: [rad] (n,).

    Returns:
        position [m] (3,), rotation matrix (3, 3), Jacobian (6, n): linear rows first.
    """
    pos, rot = jnp.zeros(3), jnp.eye(3)
    anchors, axes = [], []
    for i in range(len(chain.lower)):
        pos = pos + rot @ chain.pos[i]
        rot = rot @ chain.rot[i]
        anchors.append(pos)
        axes.append(rot @ chain.axis[i])
        rot = rot @ axis_angle_matrix(jnp.asarray(chain.axis[i]), angles[i])
    tip, tip_rot = pos + rot @ chain.tip_pos, rot @ chain.tip_rot
    axis = jnp.stack(axes)
    linear = jnp.cross(axis, tip - jnp.stack(anchors))
    return tip, tip_rot, jnp.concatenate([linear.T, axis.T])


def inverse(
    chain: Chain,
    start: Array,
    pos: Array,
    rot: Array,
    steps: int = 60,
    damping: float = 1e-3,
    weight: Array | float = 0.3,
) -> tuple[Array, Array, Array]:
    """Inverse kinematics by damped least squares, clipped to the joint limits in every iteration.

    Args:
        chain: n hinges.
        start: initial angles [rad] (n,).
        pos: of the tip in the base frame [m] (3,).
        rot: of the tip, rotation matrix (3, 3).
        steps: iterations.
        damping: of the least squares.
        weight: of an error of one radian relative to one metre; 0 leaves the orientation free.

    Returns:
        angles [rad] (n,), remaining distance [m] (), remaining rotation [rad] ().
    """

    def error(angles: Array) -> tuple[Array, Array]:
        tip, tip_rot, jacobian = forward(chain, angles)
        return jnp.concatenate([pos - tip, rotation_error(tip_rot, rot)]), jacobian

    def step(angles: Array, _: None) -> tuple[Array, None]:
        e, j = error(angles)
        e, j = e.at[3:].multiply(weight), j.at[3:].multiply(weight)
        delta = j.T @ jnp.linalg.solve(j @ j.T + damping * jnp.eye(6), e)
        delta = delta * jnp.minimum(1.0, 0.5 / (jnp.max(jnp.abs(delta)) + 1e-9))
        return jnp.clip(angles + delta, chain.lower, chain.upper), None

    angles, _ = jax.lax.scan(step, start, length=steps)
    e, _ = error(angles)
    return angles, jnp.linalg.norm(e[:3]), jnp.linalg.norm(e[3:])
