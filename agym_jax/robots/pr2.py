"""Willow Garage PR2: two arms of seven joints with two-finger grippers on a wheeled base.

Facts from Assistive Gym v0.1, reference robots.md; kinematics in ``assets/robots/pr2.xml``.

DEVIATION(pr2-forearm): forearm and hand are capsules, fitted to the surface of AG's convex hulls: 5.1 mm apart (root mean square) on the forearm, 3.5 mm on
the hand with the wiper. Corners of the forearm's end, on which it lies on the bed's edge, are 2 to 3 mm outside ours, and the wrist's hull, which has no contacts
here, up to 5 mm. Elsewhere they differ by up to 13 mm in how far they reach. The fingers do not follow the opening: they are fitted at 0.2 rad, wider than AG's in Feeding, Reaching and
Dressing (0.03 rad) and narrower in Drinking (0.45). Until 26 November 2026, 20:40 UTC, forearm and hand were coarser (7.9 and 10.8 mm by the same measure, corners up to 18 mm): the forearm was held on the bed in AG and went on here. From states
of 16 BedBathing episodes in which PR2 touches the bed in AG, joints are 0.07 rad off 0.5 s later (median), 0.12 before. What reaches how far is on the parity page; the other
figures were measured by programs outside the repository.
Of PR2's hand and arm, only the fingertips meet the armrest; until then, the whole fingers did.
"""

import math

from agym_jax.spec import Arm, BaseSearch, MeshModel, Pose, RobotSpec

_H = math.sqrt(0.5)
_C, _S = math.cos(0.1), math.sin(0.1)
# robots.md section 3, action order
_JOINTS = (
    "shoulder_pan",
    "shoulder_lift",
    "upper_arm_roll",
    "elbow_flex",
    "forearm_roll",
    "wrist_flex",
    "wrist_roll",
)
_FINGERS = ("l_finger", "l_finger_tip", "r_finger", "r_finger_tip")
_LINKS = (
    "gripper_fingers",
    "gripper_palm_left",
    "gripper_palm_right",
    "forearm_end",
    "forearm_link",
    "elbow_flex_link",
)
# AG v0.1 world_creation.py: tucked left arm (robots.md section 6); the right one mirrors the turns
_TUCKED = (1.75, 1.25, 1.5, -0.5, 1.0, 0.0, 1.0)
_MIRROR = (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0)


def _arm(side: str) -> Arm:
    s = side[0]
    return Arm(
        joints=tuple(f"{s}_{x}_joint" for x in _JOINTS),
        end_effector=f"{s}_gripper_tool_frame",
        tool_frame=f"{side}_tool_frame",
        gripper=tuple(f"{s}_gripper_{x}_joint" for x in _FINGERS),
        links=tuple(f"{s}_{x}_collision" for x in _LINKS),
    )


PR2 = RobotSpec(
    name="PR2",
    model="robots/pr2.xml",
    arms={"left": _arm("left"), "right": _arm("right")},
    torso="torso_reference",
    # AG v0.1 task files, the same angle on all four finger joints (robots.md section 5)
    gripper_opening={
        "scratcher": 0.25,
        "wiper": 0.2,
        "scooper": 0.15,
        "spoon": 0.03,
        "cup": 0.45,
        "hand": 0.03,
    },
    # robots.md sections 9 and 4, turned from *_gripper_tool_frame into the canonical frame
    grasps={
        # AG: position 0, axes of the link
        "scratcher": Pose((0.0, 0.0, 0.0), (0.5, -0.5, -0.5, -0.5)),
        "wiper": Pose((0.0, 0.0, 0.0), (0.5, -0.5, -0.5, -0.5)),
        # AG: tool_left, tool_right at (0.125, 0, -0.075), rpy (pi/2, 0, 0)
        "scooper": Pose((0.0, -0.075, 0.125), (_H, 0.0, -_H, 0.0)),
        # AG: (0, -0.03, -0.11), turned by -0.2 rad about the approach; (-0.01, 0, -0.05)
        "spoon": Pose(
            (-0.03, -0.11, 0.0),
            (-0.5 * (_C - _S), 0.5 * (_C + _S), 0.5 * (_C - _S), 0.5 * (_C + _S)),
        ),
        "cup": Pose((0.0, -0.05, -0.01), (_H, 0.0, -_H, 0.0)),
    },
    rest={f"l_{x}_joint": q for x, q in zip(_JOINTS, _TUCKED, strict=True)}
    | {f"r_{x}_joint": m * q for x, q, m in zip(_JOINTS, _TUCKED, _MIRROR, strict=True)},
    # robots.md section 7: (-0.85, -0.4) and the task's pos_offset
    searches={
        "ScratchItch": BaseSearch((-0.75, -0.4, 0.0)),
        "BedBathing": BaseSearch((-0.95, -0.4, 0.0)),
        "ArmManipulation": BaseSearch((-1.15, 0.3, 0.0)),
        "Reaching": BaseSearch((-0.75, -0.2, 0.0)),
        "Feeding": BaseSearch((-0.75, -0.2, 0.0)),
        "Drinking": BaseSearch((-0.65, -0.2, 0.0), for_mouth=True),
        "Dressing": BaseSearch((0.85, 0.3, 0.0), side=1.0, yaw=math.pi),
    },
    # limits of 1e10 in AG (Jaco's, as wide here, are of two turns there)
    endless=tuple(f"{s}_{x}_roll_joint" for s in "lr" for x in ("forearm", "wrist")),
    meets_itself=True,  # AG v0.1 loads it without self-collision (robots.md section 2)
    # tasks.md sections 2, 3, 7, 8: Euler (0, 0, 0), the hand points along world +x; Reaching (pi/2, 0, 0)
    start_rotations={
        "ScratchItch": (1.0, 0.0, 0.0, 0.0),
        "BedBathing": (1.0, 0.0, 0.0, 0.0),
        "ArmManipulation": (1.0, 0.0, 0.0, 0.0),
        "Reaching": (_H, _H, 0.0, 0.0),
        # sections 4, 5: (pi/2, 0, 0); (0, 0, 0)
        "Feeding": (_H, _H, 0.0, 0.0),
        "Drinking": (1.0, 0.0, 0.0, 0.0),
        # section 6: (0, 0, pi), the hand points along world -x
        "Dressing": (0.0, 0.0, 0.0, 1.0),
    },
    # BSD, says the package's README of pr2_description
    meshes=(
        MeshModel(
            "example-robot-data",
            "cmeel.prefix/share/example-robot-data/robots/pr2_description/urdf/pr2.urdf",
            ("base_footprint", "base_footprint"),
            # where Assistive Gym has them; ours do not move
            angles={"torso_lift_joint": 0.33, "laser_tilt_mount_joint": 0.0},
            # its textures are not there: white and grey instead of the blue, green and red below them
            colours={
                (0.0, 0.0, 0.8, 1.0): (0.84, 0.84, 0.84, 1.0),
                (0.0, 0.8, 0.0, 1.0): (0.65, 0.65, 0.66, 1.0),
                (0.8, 0.0, 0.0, 1.0): (0.3, 0.3, 0.31, 1.0),
            },
        ),
    ),
)
