"""Kinova Jaco (j2s7s300): one arm of seven joints and a hand of three fingers.

Facts from Assistive Gym v0.1, reference robots.md; kinematics in ``assets/robots/jaco.xml``.
"""

import math

from agym_jax.spec import Arm, Pose, RobotSpec

_ARM = Arm(
    joints=tuple(f"j2s7s300_joint_{i}" for i in range(1, 8)),
    end_effector="j2s7s300_end_effector",
    tool_frame="tool_frame",
    gripper=tuple(f"j2s7s300_joint_finger_{i}" for i in range(1, 4)),
    links=("link_7_collision", "link_6_collision", "link_5_collision", "link_4_collision"),
)
_H = math.sqrt(0.5)

JACO = RobotSpec(
    name="Jaco",
    model="robots/jaco.xml",
    arms={"left": _ARM, "right": _ARM},
    torso="torso_reference",
    # AG v0.1 task files, gripper positions (robots.md section 5)
    gripper_opening={"scratcher": 1.0},
    # AG v0.1 world_creation.py: beside the wheelchair, yaw -90 degrees (robots.md section 7)
    bases={"wheelchair": Pose((-0.35, -0.3, 0.36), (_H, 0.0, 0.0, -_H))},
    mounts={"wheelchair": "furniture/jaco_mount.xml"},
    # AG v0.1 scratch_itch.py: Euler (0, pi/2, 0), the hand points along world +x
    start_rotations={"ScratchItch": (_H, 0.0, _H, 0.0)},
)
