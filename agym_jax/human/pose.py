"""How the person of an episode sits or lies: chest pose and joint angles.

DEVIATION(level-forearm): a seated person whose elbow cannot bend to 90 degrees leans the upper arm
forward instead; AG only clips the elbow, which puts the forearm 2 cm into the armrest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.human import anthropometry, body
from agym_jax.human.population import Human
from agym_jax.human.posture import Postures, load_postures
from agym_jax.math3d import rotation_matrix
from agym_jax.spec import HumanSpec

STATURE, GIRTH = 3.0, 5.0
"""Weights of differences of size, beside 1 for sex: the arms of people between the bank's sizes then
float about half as far as if all three counted alike."""
WIDER, NARROWER = 30.0, 2.0
"""Weights of limits that are wider or narrower than a person's.

A posture from within narrower limits needs no clipping. One from wider limits does, and an arm that is
clipped may sink into the bed or hover above it; 0.01 of limit_scale is up to 2 degrees."""
TIE = 0.05  # of rows that are about as near, any may be drawn

CHEST_Y = 0.03  # AG human_creation.py: the seated chest is at (0, 0.03, 0.89 or 0.86)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BodyPose:
    """Of a whole person."""

    root_pos: Any  # chest, world [m]                                        (3,)
    root_quat: Any  # chest, wxyz                                            (4,)
    angles: Any  # every joint, in the order of body.JOINTS [rad]            (41,)


def sample_pose(key: jax.Array, spec: HumanSpec, human: Human) -> BodyPose:
    """Draw how a person sits, or lies as gravity left somebody of like size and limits.

    Args:
        key: PRNG key.
        spec: the task's fixed angles and ranges, or its bank of settled postures.
        human: who.
    """
    return sample_pose_and_row(key, spec, human)[0]


def sample_pose_and_row(
    key: jax.Array, spec: HumanSpec, human: Human
) -> tuple[BodyPose, jax.Array | None]:
    """Draw a pose; also return which row () of the bank of settled postures it is, None if the task has none.

    Args:
        key: PRNG key.
        spec: the task's fixed angles and ranges, or its bank of settled postures.
        human: who.
    """
    if not spec.postures:
        widths = np.array([spec.pose_range.get(j, 0.0) for j in body.JOINTS], np.float32)
        noise = widths * jax.random.uniform(key, widths.shape, minval=-1.0, maxval=1.0)
        pose = seated(
            spec, human.dims, human.sex, human.stature, human.girth, jnp, human.limit_scale
        )
        return BodyPose(pose.root_pos, pose.root_quat, pose.angles + noise), None
    bank = load_postures(spec.postures)
    apart = unlikeness(bank, human.sex, human.stature, human.girth, human.limit_scale, jnp)
    row = jnp.argmin(apart + jax.random.uniform(key, apart.shape, maxval=TIE))
    return lying(bank, row, human.dims, jnp), row


def unlikeness(
    bank: Postures, sex: Any, stature: Any, girth: Any, limit_scale: Any, xp: Any
) -> Any:
    """How unfit each row of a bank is for a person; 0 is somebody alike (K,)."""
    size = abs(bank.sex - sex) + STATURE * abs(bank.stature - stature)
    size = size + GIRTH * abs(bank.girth - girth)
    wider = bank.limit_scale - limit_scale
    return size + xp.where(wider > 0.0, WIDER * wider, -NARROWER * wider)


def seated(
    spec: HumanSpec,
    d: anthropometry.Dims,
    sex: Any,
    stature: Any,
    girth: Any,
    xp: Any,
    limit_scale: Any = 1.0,
) -> BodyPose:
    """The task's fixed pose, with the chest where this person's is when the thighs rest on the seat.

    An upper arm leans forward by what the elbow cannot bend, so that the forearm stays level.
    """
    height = anthropometry.sitting_height(d, sex, stature, girth)
    zero = 0.0 * height
    root = xp.stack([xp.asarray(zero), xp.asarray(CHEST_Y + zero), xp.asarray(height)])
    angles = xp.asarray([spec.pose.get(j, 0.0) for j in body.JOINTS], dtype="float32")
    order = list(body.JOINTS)
    for side in "rl":
        elbow = spec.pose.get(f"{side}_elbow_x", 0.0)
        (least, _), *_ = body.joint_limits((f"{side}_elbow_x",), limit_scale, xp)
        lean = -xp.maximum(least - elbow, 0.0)
        angles = angles + lean * (np.arange(len(order)) == order.index(f"{side}_shoulder_x"))
    return BodyPose(root, xp.asarray((1.0, 0.0, 0.0, 0.0)) + zero, angles + zero)


def lying(bank: Postures, row: Any, d: anthropometry.Dims, xp: Any) -> BodyPose:
    """A row of a bank, raised or lowered by as much as this person's chest is thicker or thinner."""
    at = lambda x: xp.asarray(x)[row]  # noqa: E731
    settled = anthropometry.dims(at(bank.sex), at(bank.stature), at(bank.girth))
    up = xp.asarray((0.0, 0.0, 1.0)) * (d.chest_r - settled.chest_r)
    return BodyPose(at(bank.root_pos) + up, at(bank.root_quat), at(bank.angles))


def typical(
    spec: HumanSpec,
    sex: float,
    stature: float = 1.0,
    girth: float = 1.0,
    limit_scale: float = 1.0,
) -> BodyPose:
    """A pose to build a scene with, in NumPy."""
    d = anthropometry.dims(sex, stature, girth)
    if not spec.postures:
        return seated(spec, d, sex, stature, girth, np, limit_scale)
    bank = load_postures(spec.postures)
    row = np.argmin(unlikeness(bank, sex, stature, girth, limit_scale, np))
    return lying(bank, int(row), d, np)


def posed_joints(spec: HumanSpec) -> tuple[str, ...]:
    """Joints that a pose may bend: the others are 0, or at the limit nearest to it."""
    if spec.postures:
        return tuple(body.JOINTS)
    bent = {*spec.pose, *spec.pose_range, "r_shoulder_x", "l_shoulder_x"}
    return tuple(j for j in body.JOINTS if j in bent)


def rows(
    spec: HumanSpec,
    pose: BodyPose,
    d: anthropometry.Dims,
    moving: tuple[str, ...],
    limit_scale: Any,
    xp: Any,
    at_joints: Any = 0.0,
) -> body.BodyFields:
    """The person's rows of the MuJoCo model in that pose, see ``body.fields``; NumPy or JAX."""
    order = list(body.JOINTS)
    angles = {j: pose.angles[order.index(j)] for j in posed_joints(spec)}
    root = pose.root_pos, pose.root_quat
    return body.fields(d, angles, moving, limit_scale, *root, xp, at_joints)


def mouth_of(
    spec: HumanSpec, pose: BodyPose, d: anthropometry.Dims, limit_scale: Any, xp: Any
) -> Any:
    """Where the person's mouth is in that pose, world [m] (3,); NumPy or JAX."""
    # no joint is free, so that every link has a pose in the world
    fields = rows(spec, pose, d, (), limit_scale, xp)
    head = [link.name for link in body.LINKS].index("head")
    local = xp.stack([xp.zeros_like(d.mouth_y), d.mouth_y, d.mouth_z])
    return fields.body_pos[head] + rotation_matrix(fields.body_quat[head], xp) @ local


def start_angles(pose: BodyPose, joints: tuple[str, ...], limit_scale: Any, xp: Any) -> Any:
    """Angles of the moving joints, within this person's limits [rad] (n,)."""
    if not joints:
        return xp.zeros(0)
    order = list(body.JOINTS)
    low, high = body.joint_limits(joints, limit_scale, xp).T
    return xp.clip(xp.stack([pose.angles[order.index(j)] for j in joints]), low, high)
