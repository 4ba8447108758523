"""What one control step shows: the only reader of ``mjx.Data``.

Works on one world of ``mjx.Data`` and, because the field names are the same, on C ``MjData``.
Forces are normal forces of contact sensors, averaged over the physics steps of a control step.

DEVIATION(force-mean): contact forces are means over the five physics steps of a control step, not
the last one's value: a single step's is noisy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.index import Index
from agym_jax.person.anthropometry import Dims


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Touch:
    """Sums of the contact sensors over physics steps."""

    tool_person: Array  # normal force of each tool-person pair [N]         (n_touch,)
    tool_person_moment: Array  # force times contact point [N m]            (n_touch, 3)
    tool_seat: Array  # [N]                                                 ()
    robot_person: Array  # [N]                                              ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensed:
    """One control step, in world coordinates; everything a task may know."""

    tool_pos_w: Array  # tip of the tool [m]                                 (3,)
    tool_quat_w: Array  # wxyz                                               (4,)
    tool_vel_w: Array  # linear velocity of the tip [m/s]                    (3,)
    arm_angles: Array  # of the robot [rad]                                  (n_arm,)
    torso_pos_w: Array  # reference point of the robot [m]                   (3,)
    person_angles: Array  # of the controllable joints [rad]                 (n_person,)
    person_pos_w: Array  # chest [m]                                         (3,)
    shoulder_pos_w: Array  # of the arm that is helped [m]                   (3,)
    elbow_pos_w: Array  # [m]                                                (3,)
    wrist_pos_w: Array  # [m]                                                (3,)
    upper_arm_rot_w: Array  # rotation matrix                                (3, 3)
    forearm_rot_w: Array  # rotation matrix                                  (3, 3)
    upper_arm_length: Array  # [m]                                           ()
    upper_arm_radius: Array  # [m]                                           ()
    forearm_length: Array  # [m]                                             ()
    forearm_radius: Array  # [m]                                             ()
    touch_force: Array  # normal force of each tool-person contact [N]       (n_touch,)
    touch_pos_w: Array  # where; the origin when there is none [m]           (n_touch, 3)
    tool_on_person: Array  # sum [N]                                         ()
    robot_on_person: Array  # links of the robot on the person [N]           ()
    tool_force: Array  # all contacts of the tool [N]                        ()


def no_touch(index: Index) -> Touch:
    """The empty sum."""
    n = len(index.tool_person)
    return Touch(jnp.zeros(n), jnp.zeros((n, 3)), jnp.float32(0.0), jnp.float32(0.0))


def add_touch(index: Index, touch: Touch, sensordata: Array) -> Touch:
    """Add one physics step's contact sensors.

    Args:
        index: sensor addresses.
        touch: the sum so far.
        sensordata: of ``Data`` (nsensordata,).
    """
    force = jnp.abs(sensordata[index.tool_person])
    pos = sensordata[index.tool_person[:, None] + jnp.arange(3, 6)]
    return Touch(
        tool_person=touch.tool_person + force,
        tool_person_moment=touch.tool_person_moment + force[:, None] * pos,
        tool_seat=touch.tool_seat + jnp.sum(jnp.abs(sensordata[index.tool_seat])),
        robot_person=touch.robot_person + jnp.sum(jnp.abs(sensordata[index.robot_person])),
    )


def sense(index: Index, data: Any, touch: Touch, n_steps: int, dims: Dims) -> Sensed:
    """Read one world.

    Args:
        index: of the scene.
        data: ``mjx.Data`` of one world (or ``MjData``) whose kinematics are up to date.
        touch: sums over the control step.
        n_steps: physics steps in those sums.
        dims: sizes of the person.
    """
    tip = jnp.asarray(data.site_xpos)[index.tip_site]
    axis = jnp.asarray(data.xaxis)[index.robot_joint]
    anchor = jnp.asarray(data.xanchor)[index.robot_joint]
    speed = jnp.asarray(data.qvel)[index.robot_dof]
    xpos, xmat = jnp.asarray(data.xpos), jnp.asarray(data.xmat).reshape(-1, 3, 3)
    force = touch.tool_person / n_steps
    has = touch.tool_person > 0
    where = touch.tool_person_moment / jnp.where(has, touch.tool_person, 1.0)[:, None]
    on_person = jnp.sum(force)
    return Sensed(
        tool_pos_w=tip,
        tool_quat_w=_quat_mul(jnp.asarray(data.xquat)[index.tool_body], index.tool_quat),
        tool_vel_w=jnp.sum(jnp.cross(axis, tip - anchor) * speed[:, None], axis=0),
        arm_angles=jnp.asarray(data.qpos)[index.robot_qpos],
        torso_pos_w=jnp.asarray(data.site_xpos)[index.torso_site],
        person_angles=jnp.asarray(data.qpos)[index.person_qpos],
        person_pos_w=xpos[index.chest_body],
        shoulder_pos_w=xpos[index.upper_arm_body],
        elbow_pos_w=xpos[index.forearm_body],
        wrist_pos_w=xpos[index.hand_body],
        upper_arm_rot_w=xmat[index.upper_arm_body],
        forearm_rot_w=xmat[index.forearm_body],
        upper_arm_length=jnp.asarray(dims.upper_arm_l),
        upper_arm_radius=jnp.asarray(dims.upper_arm_r),
        forearm_length=jnp.asarray(dims.forearm_l),
        forearm_radius=jnp.asarray(dims.forearm_r),
        touch_force=force,
        touch_pos_w=where,
        tool_on_person=on_person,
        robot_on_person=touch.robot_person / n_steps,
        tool_force=on_person + touch.tool_seat / n_steps,
    )


def _quat_mul(a: Array, b: Any) -> Array:
    """Product of quaternions wxyz."""
    b = jnp.asarray(b, jnp.float32)
    vector = a[0] * b[1:] + b[0] * a[1:] + jnp.cross(a[1:], b[1:])
    return jnp.concatenate([(a[0] * b[0] - jnp.dot(a[1:], b[1:]))[None], vector])
