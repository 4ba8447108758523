"""Kinova Jaco (j2s7s300): one arm of seven joints and a hand of three fingers.

Facts from Assistive Gym v0.1, reference robots.md; kinematics in ``assets/robots/jaco.xml``.

DEVIATION(jaco-hand): palm and fingers are capsules, the fingers' of 10.5 mm radius; vertices of AG's convex hulls lie up to 15 mm outside
the palm's and 7 mm outside the fingers'. A scratcher's handle that meets the arm in AG, flush with the fingers, comes a little after
them here. Replayed pushes on a held arm (parity page, AG's masses) have joints 0.025 rad from AG's after 1 s, 0.08 after 2 s and
0.44 after 4 s in the median: in half of the episodes a hand that AG's contacts hold fast, one joint at the bound of its torque, slips past the
arm here. No single cause is known: fingers 3 mm thicker or thinner move joints by 0.03 rad after 2 s and by 0.03 to 0.06 after 4 s,
a palm 5 mm thicker by nothing, the scratcher 1 mm thicker by 0.02 and 0.06, friction 20 % higher by 0.03 and 0.09, a round friction cone by
0.04 and 0.08; with the last two, one at a time, the medians after 4 s are 0.21 and 0.14 instead of 0.44. The wrist (link 6) is a capsule of 33 mm
radius, outside of which the vertices of AG's hull are by 4 mm in the median and 6.4 mm at the 90th percentile: where AG's wrist lies on the
bed's edge, in 60 to 150 steps of the BedBathing episodes that fail there, ours passes 5 to 8 mm above it.

DEVIATION(nightstand): the nightstand beside the bed is a box for the robot and another for the person's arm; AG's is the convex hull of a mesh,
whose front bulges below the edge by 3 cm, where a hanging arm meets it. In postures of AG's episodes Jaco's third link, which lies on the edge in most
of them, is 0.3 mm nearer than in AG, and the person's forearm and hand 2 mm (medians; until 23 November 2026, 11:10 UTC, 7 and 23 mm farther). AG loads
the nightstand after it has searched for the base: in 3 of 20 episodes the third link begins 2 to 6 cm inside and is pushed out; here such starts are tried again.

Hand, wrist and tool meet the two lowest links of the arm and, beside the bed, the nightstand, as in AG, whose distances of link from
link these capsules keep within 1 cm on average (3,000 random postures). Without it a policy for ArmManipulation learned to fold the
hand through the upper arm: in AG they were in contact in 72 % of its steps, and it helped in 1 of 10 episodes.
"""

import math

from agym_jax.spec import Arm, BaseSearch, MeshModel, MeshPart, Pose, Rgba, RobotSpec

_ARM = Arm(
    joints=tuple(f"j2s7s300_joint_{i}" for i in range(1, 8)),
    end_effector="j2s7s300_end_effector",
    tool_frame="tool_frame",
    gripper=tuple(f"j2s7s300_joint_finger_{i}" for i in range(1, 4)),
    links=(
        "link_7_collision",
        "finger_1_collision",
        "finger_2_collision",
        "finger_3_collision",
        "link_6_collision",
        "link_5_collision",
        "link_4_collision",
    ),
    hand=5,
)
_ROBOSUITE = "robosuite/models/assets"
_BLACK, _PLASTIC = (0.05, 0.05, 0.05, 1.0), (0.88, 0.86, 0.86, 1.0)  # as robosuite paints them
_CARBON = (0.14, 0.14, 0.14, 1.0)  # light enough for its forms to be seen


def _hand_mesh(name: str, link: str, rgba: Rgba) -> MeshPart:
    """A mesh of robosuite's hand, whose frame is the link's."""
    folder = f"{_ROBOSUITE}/grippers/meshes/jaco_three_finger_gripper"
    return MeshPart("robosuite", f"{folder}/{name}.stl", f"j2s7s300_link_{link}", rgba)


_H = math.sqrt(0.5)
_C, _S = math.cos(0.05), math.sin(0.05)

JACO = RobotSpec(
    name="Jaco",
    model="robots/jaco.xml",
    arms={"left": _ARM, "right": _ARM},
    torso="torso_reference",
    # AG v0.1 task files, gripper positions (robots.md section 5)
    gripper_opening={
        "scratcher": 1.0,
        "wiper": 1.1,
        "scooper": 1.05,
        "spoon": 1.33,
        "cup": 0.63,
        "hand": 1.33,
    },
    grasps={
        # robots.md section 9: x along the approach, z against the hand's x
        "scratcher": Pose((0.0, 0.0, 0.02), (_H, 0.0, -_H, 0.0)),
        "wiper": Pose((-0.01, 0.0, 0.03), (_H, 0.0, -_H, 0.0)),
        # robots.md section 4: URDF joint of the tool, rpy (pi/2, -pi/2, 0)
        "scooper": Pose((0.075, 0.0, 0.14), (0.5, 0.5, -0.5, 0.5)),
        # robots.md section 9: turned by 0.1 rad about the approach
        "spoon": Pose((0.1, -0.0225, 0.03), (-_H * _C, _H * _S, _H * _C, _H * _S)),
        "cup": Pose((0.05, -0.005, 0.0), (_H, 0.0, 0.0, _H)),
    },
    # AG v0.1 world_creation.py: beside the wheelchair, yaw -90 degrees (robots.md section 7); the
    # tutorial's Reaching has yaw 0
    bases={
        "wheelchair": Pose((-0.35, -0.3, 0.36), (_H, 0.0, 0.0, -_H)),
        "Reaching": Pose((-0.35, -0.3, 0.36)),
        "Dressing": Pose((0.35, -0.3, 0.36)),
    },
    mounts={
        "wheelchair": "furniture/jaco_mount.xml",
        "wheelchair_left": "furniture/jaco_mount_left.xml",
        "bed": "furniture/nightstand.xml",
    },
    solid_mounts={"bed": ("nightstand_collision",)},
    mount_fronts={"bed": ("nightstand_front",)},
    # AG loads it with self-collision; of 3,000 random postures no other links that are not neighbours meet
    trunk=("link_1_collision", "link_2_collision"),
    near_mount=("link_3_corners",),
    # robots.md section 7: beside the bed on a nightstand, spread 0.1 m
    searches={
        "BedBathing": BaseSearch((-0.9, 0.65, 0.6), spread=0.1),
        "ArmManipulation": BaseSearch((-0.9, 0.75, 0.6), spread=0.1),
    },
    base_height=0.6,
    # the arm at 0 is exactly half a turn away and goes backwards, as 40 recorded starts show
    half_turns={"Feeding": -1.0},
    # tasks.md sections 4, 5 and 8
    start_within={"Feeding": 0.01, "Drinking": 0.01, "Reaching": 0.01},
    # tasks.md sections 2, 3, 7: Euler (0, pi/2, 0), the hand points along world +x; 8: (pi/2, 0, pi/2)
    start_rotations={
        "ScratchItch": (_H, 0.0, _H, 0.0),
        "BedBathing": (_H, 0.0, _H, 0.0),
        "ArmManipulation": (_H, 0.0, _H, 0.0),
        "Reaching": (0.5, 0.5, 0.5, 0.5),
        # sections 4, 5: (pi/2, 0, pi/2); (0, pi/2, 0)
        "Feeding": (0.5, 0.5, 0.5, 0.5),
        "Drinking": (_H, 0.0, _H, 0.0),
        # section 6: (0, -pi/2, 0), the hand points along world -x
        "Dressing": (_H, 0.0, -_H, 0.0),
    },
    # MIT. The hand's own model there turns its fingers about other axes; the meshes are the URDF's.
    meshes=(
        MeshModel(
            "robosuite",
            f"{_ROBOSUITE}/robots/jaco/robot.xml",
            ("j2s7s300_link_0", "j2s7s300_link_base"),
            colours={_BLACK: _CARBON},
        ),
        _hand_mesh("hand_3finger", "7", _CARBON),
        _hand_mesh("ring_small", "7", _PLASTIC),
        *(_hand_mesh("finger_proximal", f"finger_{i}", _PLASTIC) for i in (1, 2, 3)),
        *(_hand_mesh("finger_distal", f"finger_tip_{i}", _PLASTIC) for i in (1, 2, 3)),
    ),
)
