"""Observations of the assisted arm, shared by Assistive Gym's tasks that involve the right arm.

Each task's record includes one of these as a ``part``, whose columns take the record's source.
"""

from __future__ import annotations

from jax import Array

from agym_jax.human.body import RIGHT_ARM_LINKS
from agym_jax.observe import column, observation
from agym_jax.sense import Sensed


@observation
class ArmFromTorso:
    """The arm as observed by the robot."""

    shoulder_pos_torso: Array = column(3, "m", "world axes, from the torso")
    elbow_pos_torso: Array = column(3, "m", "world axes, from the torso")
    wrist_pos_torso: Array = column(3, "m", "world axes, from the torso")


@observation
class ArmFromChest:
    """The arm as observed by the active person."""

    shoulder_pos_human: Array = column(3, "m", "world axes, from the chest")
    elbow_pos_human: Array = column(3, "m", "world axes, from the chest")
    wrist_pos_human: Array = column(3, "m", "world axes, from the chest")


def see_arm(sensed: Sensed) -> tuple[ArmFromTorso, ArmFromChest]:
    """Return the arm as observed by robot and person."""
    joints = [sensed.link_pos_w[link] for link in RIGHT_ARM_LINKS]
    return (
        ArmFromTorso(*(joint - sensed.torso_pos_w for joint in joints)),
        ArmFromChest(*(joint - sensed.human_pos_w for joint in joints)),
    )
