"""Code shared by Feeding and Drinking: the person, the observations, and the obstacles of the particles.

Assistive Gym v0.1 ``feeding.py`` and ``drinking.py`` (reference tasks.md sections 4 and 5): the person
sits in the wheelchair with the head turned by up to 30 degrees; the goal is the mouth.

DEVIATION(particle-obstacles): particles meet tool, person, table, bowl and floor, not the robot and not
the wheelchair. What is eaten, spilled or poured away leaves the simulation; AG puts what is eaten far
away and lets the rest lie.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from agym_jax.human.body import HEAD
from agym_jax.human.capsules import link_capsules
from agym_jax.math3d import child_pose
from agym_jax.matter.particles.solver import Obstacles, Particles
from agym_jax.matter.shapes import Boxes, Capsules
from agym_jax.observe import column, observation
from agym_jax.sense import Sensed
from agym_jax.spec import Ending, HumanSpec, Pose

_RAD = math.pi / 180.0

TOUCHABLE = (
    "head", "neck", "chest", "right_girdle", "left_girdle", "right_upper_arm", "right_forearm",
    "right_hand",
)  # fmt: skip
"""Limbs that the tool and the hand may touch."""
BELOW = ("waist", "left_upper_arm", "left_forearm", "left_hand", "right_thigh", "left_thigh")
"""Further limbs on which particles may fall."""
THINNEST = 0.024
"""Smallest half thickness of anything on which particles fall [m]: the forearm of a slender woman; table and bowl are
thicker."""
Endings = tuple[Ending, ...]
SEEN = "feeding.py, drinking.py _get_obs"


def endings(got: str, left: str) -> Endings:
    """Return the ways in which a meal fails.

    Args:
        got: name of the measure of what was eaten or drunk.
        left: what holds of the others, in words.
    """
    return (
        Ending("more than a quarter spilled", "spilled", low=0.251),
        Ending(f"nothing {got}", got, high=0.001),
        Ending(left, got),
    )


def diner(rate: float, max_torque: float) -> HumanSpec:
    """Describe the person who is fed. AG feeding.py, drinking.py reset; humans.md sections 5 to 7.

    Args:
        rate: AG's gain divided by its solver sub-step [1/s].
        max_torque: torque limit of a person with full strength [N m].
    """
    return HumanSpec(
        joints=HEAD,
        pose={
            "r_elbow_x": -90 * _RAD, "l_elbow_x": -90 * _RAD, "r_hip_x": -90 * _RAD,
            "r_knee_x": 80 * _RAD, "l_hip_x": -90 * _RAD, "l_knee_x": 80 * _RAD,
        },
        pose_range={"head_x": 30 * _RAD, "head_y": 30 * _RAD, "head_z": 30 * _RAD},
        hold_rate=rate,
        move_rate=rate,
        max_torque=max_torque,
        tremor_amplitude=20 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=TOUCHABLE,
        links=BELOW,
        passive_mode="frozen",
    )  # fmt: skip


@observation
class RobotObs:
    """Observation of the robot."""

    tool_pos_torso: Array = column(3, "m", "world axes, from the robot's torso", SEEN)
    tool_quat_w: Array = column(4, "1 (wxyz)", "world", SEEN)
    tool_pos_mouth: Array = column(3, "m", "world axes, from the mouth", SEEN)
    arm_angles: Array = column(7, "rad", "joints", SEEN)
    head_pos_torso: Array = column(3, "m", "world axes, from the torso", SEEN)
    head_quat_w: Array = column(4, "1 (wxyz)", "world", SEEN)
    tool_on_human: Array = column(1, "N", "tool on the person", SEEN)


@observation
class HumanObs:
    """Observation of the active person."""

    tool_pos_human: Array = column(3, "m", "world axes, from the chest", SEEN)
    tool_quat_w: Array = column(4, "1 (wxyz)", "world", SEEN)
    tool_pos_mouth: Array = column(3, "m", "world axes, from the mouth", SEEN)
    human_angles: Array = column(4, "rad", "neck and head joints", SEEN)
    head_pos_human: Array = column(3, "m", "world axes, from the chest", SEEN)
    head_quat_w: Array = column(4, "1 (wxyz)", "world", SEEN)
    robot_on_human: Array = column(1, "N", "robot on the person", SEEN)
    tool_on_human: Array = column(1, "N", "tool on the person", SEEN)


def observe(sensed: Sensed) -> tuple[RobotObs, HumanObs]:
    """Return the observations of robot and person."""
    s, tool = sensed, sensed.tool
    head, quat = s.link_pos_w["head"], s.link_quat_w["head"]
    to_mouth = tool.pos_w - s.mouth_pos_w
    robot = RobotObs(
        tool_pos_torso=tool.pos_w - s.torso_pos_w,
        tool_quat_w=tool.quat_w,
        tool_pos_mouth=to_mouth,
        arm_angles=s.arm_angles,
        head_pos_torso=head - s.torso_pos_w,
        head_quat_w=quat,
        tool_on_human=s.tool_on_human,
    )
    human = HumanObs(
        tool_pos_human=tool.pos_w - s.human_pos_w,
        tool_quat_w=tool.quat_w,
        tool_pos_mouth=to_mouth,
        human_angles=s.human_angles,
        head_pos_human=head - s.human_pos_w,
        head_quat_w=quat,
        robot_on_human=s.robot_on_human,
        tool_on_human=s.tool_on_human,
    )
    return robot, human


class Outcome(NamedTuple):
    """What became of every particle in one control step; the masks are mutually exclusive."""

    eaten: Array  # (n,) bool
    spilled: Array  # (n,) bool
    hit: Array  # counted as a hit of the person (n,) bool
    speed: Array  # sum over the eaten ones, before they vanish [m/s] ()


def obstacles(sensed: Sensed, vessel: Pose, furniture: Boxes) -> Obstacles:
    """Return the obstacles of the particles at every physics step of the control step.

    Args:
        sensed: sensed data, with the motion over n physics steps.
        vessel: frame of the vessel that holds the particles, in the tool's frame.
        furniture: boxes of furniture, at rest.
    """
    motion = sensed.motion
    pos, quat = child_pose(motion.tool_pos_w, motion.tool_quat_w, vessel.pos, vessel.quat)
    links = (*TOUCHABLE, *BELOW)
    human = link_capsules(sensed.dims, links, motion.link_pos_w, motion.link_rot_w)
    return Obstacles(
        vessel_pos_w=pos,
        vessel_quat_w=quat,
        human=Capsules(*human),
        furniture=furniture,
        floor=jnp.float32(0.0),
    )


PRIVILEGED_OBS_SIZE = 5


def privileged_obs(matter: Particles, eaten: Array, mouth_pos_w: Array) -> Array:
    """Return what is left and where: future rewards depend on it, but neither agent observes it (PRIVILEGED_OBS_SIZE,).

    Args:
        matter: food or water.
        eaten: number of particles eaten ().
        mouth_pos_w: current position of the mouth [m] (3,).
    """
    left = jnp.sum(matter.alive, dtype=jnp.float32)
    off = jnp.where(matter.alive[:, None], matter.pos_w - mouth_pos_w, 0.0)
    shares = jnp.stack([left, eaten]) / len(matter.alive)
    return jnp.concatenate([shares, off.sum(0) / jnp.maximum(left, 1.0)])


def delivered(matter: Particles, eaten: Array, lost: Array) -> tuple[Array, Array]:
    """Return the fractions of the particles that have been eaten and that have otherwise disappeared, each ().

    Args:
        matter: food or water.
        eaten: number of particles eaten ().
        lost: number of particles that became non-finite, which count as neither ().
    """
    count = len(matter.alive)
    left = jnp.sum(matter.alive, dtype=jnp.float32)
    return eaten / count, (count - left - eaten - lost) / count


def drawn(pos_w: Array, alive: Array) -> Array:
    """Return positions for rendering: NaN where a particle is gone (n, 3)."""
    return jnp.where(alive[:, None], pos_w, jnp.nan)
