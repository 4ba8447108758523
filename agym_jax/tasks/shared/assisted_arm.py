"""The arm that is helped, in observations: what Assistive Gym's tasks about the right arm share.

Each task's record has one of these as a ``part``, and gives it the source of its own columns.
"""

from __future__ import annotations

from jax import Array

from agym_jax.human.body import RIGHT_ARM_LINKS
from agym_jax.observe import column, observation
from agym_jax.sense import Sensed


@observation
class ArmFromTorso:
    """The arm as the robot sees it."""

    shoulder_pos_torso: Array = column(3, "m", "world axes, from the torso")
    elbow_pos_torso: Array = column(3, "m", "world axes, from the torso")
    wrist_pos_torso: Array = column(3, "m", "world axes, from the torso")


@observation
class ArmFromChest:
    """The arm as the active person feels it."""

    shoulder_pos_human: Array = column(3, "m", "world axes, from the chest")
    elbow_pos_human: Array = column(3, "m", "world axes, from the chest")
    wrist_pos_human: Array = column(3, "m", "world axes, from the chest")


def see_arm(sensed: Sensed) -> tuple[ArmFromTorso, ArmFromChest]:
    """The arm as robot and person see it."""
    joints = [sensed.link_pos_w[link] for link in RIGHT_ARM_LINKS]
    return (
        ArmFromTorso(*(joint - sensed.torso_pos_w for joint in joints)),
        ArmFromChest(*(joint - sensed.human_pos_w for joint in joints)),
    )
