"""Rethink Sawyer: one arm of seven joints on a pedestal and a gripper of two sliding fingers.

Facts from Assistive Gym v0.1, reference robots.md; kinematics in ``assets/robots/sawyer.xml``.

DEVIATION(sawyer-shapes): the arm meets the robot's pedestal and the base of its arm as in AG, from the third link outwards. Spheres and
capsules stand for AG's cylinders. Pedestal and base end 21 and 20 mm inside the upper rims, and 90 and 20 mm above the middle of the top. The last link, a coin of 65 mm
radius and 50 mm length, is a sphere 4 mm inside the rims and 41 mm beyond the faces. The upper arm ends 25 mm inside the rims, the forearm
10 mm inside them and 12 mm beyond the ends. Six arms that press on the pedestal in AG are within 12 mm of it here. The gripper is Baxter's
(`baxter-shapes`).
"""

import math

from agym_jax.robots.baxter import ROBOSUITE, gripper_meshes
from agym_jax.spec import Arm, BaseSearch, MeshModel, MeshPart, Pose, RobotSpec

_ARM = Arm(
    joints=tuple(f"right_j{i}" for i in range(7)),
    end_effector="right_gripper",
    tool_frame="tool_frame",
    gripper=("r_gripper_l_finger_joint", "r_gripper_r_finger_joint"),
    links=(
        "right_gripper_collision",  # both fingers
        "right_gripper_base_collision",
        "right_l6_collision",
        "right_l5_collision",
        "right_l4_collision",
    ),
)


def _search(x: float, y: float, side: float = -1.0, yaw: float = 0.0) -> BaseSearch:
    """Where the base may stand: AG puts the centre of mass of the root there (sawyer.json: base link)."""
    return BaseSearch((x, y, 0.975), side=side, yaw=yaw, pivot=(-0.1, 0.0, 0.07))


_H = math.sqrt(0.5)
_C, _S = math.cos(0.05), math.sin(0.05)

SAWYER = RobotSpec(
    name="Sawyer",
    model="robots/sawyer.xml",
    arms={"left": _ARM, "right": _ARM},
    torso="torso_reference",
    # AG v0.1 task files, metres by which each finger opens: left +p, right -p (robots.md section 5)
    gripper_opening={
        "scratcher": 0.015,
        "wiper": 0.0125,
        "scooper": 0.01,
        "spoon": 0.0,
        "hand": 0.0,
        "cup": 0.0208,  # AG asks for 0.025, beyond the joint's limit
    },
    grasps={
        # robots.md section 9: 0.125 and 0.1175 m out of right_gripper_base
        "scratcher": Pose((0.0, 0.0, -0.0077), (0.0, _H, 0.0, _H)),
        "wiper": Pose((0.0, 0.0, -0.0152), (0.5, -0.5, -0.5, -0.5)),
        # robots.md section 4: URDF joint of tool_right
        "scooper": Pose((0.0, 0.075, 0.1023), (0.0, _H, 0.0, _H)),
        # robots.md section 9, turned by 0.1 rad about the approach: 0.12 and 0.125 beyond the base
        "spoon": Pose(
            (-0.02, -0.1, -0.0127),
            (-0.5 * (_C - _S), 0.5 * (_C + _S), 0.5 * (_C - _S), 0.5 * (_C + _S)),
        ),
        "cup": Pose((0.0, 0.05, -0.0077), (0.0, _H, 0.0, _H)),
    },
    # robots.md section 7: (-0.85, -0.4) and the task's pos_offset; Reaching as Feeding
    searches={
        "ScratchItch": _search(-0.95, -0.4),
        "BedBathing": _search(-1.05, -0.4),
        "ArmManipulation": _search(-1.15, 0.2),
        "Reaching": _search(-0.95, -0.2),
        "Feeding": _search(-0.95, -0.2),
        "Drinking": _search(-0.95, -0.2),
        "Dressing": _search(0.95, 0.3, side=1.0, yaw=math.pi),
    },
    # AG v0.1 world_creation.py init_sawyer: self-collision between links 0 to 2 and those from right_l2 on
    trunk=("pedestal_collision", "right_arm_base_link_collision"),
    near_trunk=(*_ARM.links[_ARM.hand :], "right_l3_collision", "right_l2_collision"),
    base_height=0.905,
    start_rotations={
        # AG v0.1 scratch_itch.py, bed_bathing.py: Euler (0, pi/2, 0)
        "ScratchItch": (_H, 0.0, _H, 0.0),
        "BedBathing": (_H, 0.0, _H, 0.0),
        # AG v0.1 arm_manipulation.py: Euler (0, -pi/2, pi)
        "ArmManipulation": (0.0, _H, 0.0, _H),
        # AG v0.1 feeding.py, as the tutorial has no Sawyer: Euler (pi/2, 0, pi/2)
        "Reaching": (0.5, 0.5, 0.5, 0.5),
        "Feeding": (0.5, 0.5, 0.5, 0.5),
        # AG v0.1 drinking.py: Euler (0, -pi/2, pi), the cup upright
        "Drinking": (0.0, _H, 0.0, _H),
        # AG v0.1 dressing.py: Euler (0, -pi/2, 0), the hand along world -x
        "Dressing": (_H, 0.0, -_H, 0.0),
    },
    # MIT. Its fingers are shorter than Assistive Gym's: ours stay primitives
    meshes=(
        MeshModel(
            "robosuite",
            f"{ROBOSUITE}/robots/sawyer/robot.xml",
            ("right_arm_base_link", "right_arm_base_link"),
            colours={(1.0, 0.0, 0.0, 1.0): (0.64, 0.0, 0.0, 1.0)},  # Baxter's red
        ),
        MeshPart(
            "robosuite",
            f"{ROBOSUITE}/bases/meshes/rethink_mount/pedestal.stl",
            "pedestal",
            (0.2, 0.2, 0.2, 1.0),
            Pose((0.0, 0.0, 0.0151)),  # robosuite stands it that much lower than the URDF
        ),
        *gripper_meshes("right_gripper_base"),
    ),
)
