"""Rethink Baxter: two arms of seven joints with electric parallel grippers, on a pedestal.

Facts from Assistive Gym v0.1, reference robots.md; kinematics in ``assets/robots/baxter.xml``.

DEVIATION(baxter-shapes): spheres and capsules stand for AG's cylinders and boxes. The rims of the wrist's cylinder are 25 mm outside ours, those
of the lower forearm and the hand 18 and 13 mm, and the elbow's end of the upper forearm 37 mm, where the elbow covers a part. AG's fingers are two
blades, 10 mm thick and closed 45 mm wide, with tips of 42 mm by 29 mm; ours are one capsule of 28 mm radius that does not follow the opening: up to
25 mm outside the closed blades beside them and 3 mm beyond their tips, and up to 23 mm inside fingers around a cup. The rims of the
gripper's base are 12 mm outside ours.
"""

import math

from agym_jax.spec import Arm, BaseSearch, MeshModel, MeshPart, Pose, RobotSpec

_JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
_LINKS = ("gripper", "gripper_base", "wrist", "lower_forearm", "upper_forearm")


def _arm(side: str) -> Arm:
    """One side's names; its finger joints bear only the side's first letter."""
    return Arm(
        joints=tuple(f"{side}_{x}" for x in _JOINTS),
        end_effector=f"{side}_gripper",
        tool_frame=f"{side}_tool_frame",
        gripper=tuple(f"{side[0]}_gripper_{x}_finger_joint" for x in "lr"),
        links=tuple(f"{side}_{x}_collision" for x in _LINKS),
    )


ROBOSUITE = "robosuite/models/assets"


def gripper_meshes(link: str) -> tuple[MeshPart, ...]:
    """What the base of Rethink's electric gripper wears; Sawyer's is the same.

    The pose brings the box about robosuite's mesh to the one about Assistive Gym's.
    """
    folder = f"{ROBOSUITE}/grippers/obj_meshes/rethink_gripper/electric_gripper_base"
    pose = Pose((0.0029, 0.0, -0.025), (math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5)))
    colours = ((0.64, 0.64, 0.64, 1.0), (0.64, 0.0, 0.0, 1.0))  # as robosuite paints them
    return tuple(
        MeshPart("robosuite", f"{folder}/electric_gripper_base_{i}.obj", link, rgba, pose)
        for i, rgba in enumerate(colours)
    )


_H = math.sqrt(0.5)
_C, _S = math.cos(0.05), math.sin(0.05)
# AG v0.1 world_creation.py: both arms tucked before the search (robots.md section 6)
_REST = {
    "left": (0.75, 1.0, 0.5, 0.5, 1.0, -0.5, 0.0),
    "right": (-0.75, 1.0, -0.5, 0.5, -1.0, -0.5, 0.0),
}

BAXTER = RobotSpec(
    name="Baxter",
    model="robots/baxter.xml",
    arms={"left": _arm("left"), "right": _arm("right")},
    torso="torso_reference",
    # AG v0.1 task files: the left finger's shift [m], the right one's is its negative
    # (robots.md section 5); Reaching has no Baxter, closed as for Feeding
    gripper_opening={
        "scratcher": 0.015,
        "wiper": 0.0125,
        "scooper": 0.01,
        "spoon": 0.0,
        "hand": 0.0,
        "cup": 0.0208,  # AG asks for 0.025, beyond the joint's limit
    },
    grasps={
        # AG v0.1 task files: 0.125 and 0.1175 beyond the gripper base (robots.md section 9),
        # the tool frame 0.1327 beyond it
        "scratcher": Pose((0.0, 0.0, -0.0077), (0.0, _H, 0.0, _H)),
        "wiper": Pose((0.0, 0.0, -0.0152), (0.5, -0.5, -0.5, -0.5)),
        # URDF baxter_custom_arm_manipulation, joint of tool_left and tool_right (section 4)
        "scooper": Pose((0.0, 0.075, 0.1023), (0.0, _H, 0.0, _H)),
        # AG v0.1 task files, turned by 0.1 rad about the approach: 0.12 and 0.125 beyond the base
        "spoon": Pose(
            (-0.02, -0.1, -0.0127),
            (-0.5 * (_C - _S), 0.5 * (_C + _S), 0.5 * (_C - _S), 0.5 * (_C + _S)),
        ),
        "cup": Pose((0.0, 0.05, -0.0077), (0.0, _H, 0.0, _H)),
    },
    rest={
        f"{side}_{x}": angle
        for side, angles in _REST.items()
        for x, angle in zip(_JOINTS, angles, strict=True)
    },
    # robots.md section 7: (-0.85, -0.4) and the task's pos_offset; Reaching as Feeding
    searches={
        "ScratchItch": BaseSearch((-0.85, -0.4, 0.975)),
        "BedBathing": BaseSearch((-1.05, -0.4, 0.975)),
        "ArmManipulation": BaseSearch((-1.15, 0.2, 0.975)),
        "Reaching": BaseSearch((-0.85, -0.2, 0.975)),
        # AG v0.1 feeding.py: only the start
        "Feeding": BaseSearch((-0.85, -0.2, 0.975), requires_goals=False),
        "Drinking": BaseSearch((-0.85, -0.2, 0.975)),
        "Dressing": BaseSearch((0.85, 0.3, 0.975), side=1.0, yaw=math.pi),
    },
    base_height=0.975,
    half_range=True,  # robots.md section 7
    meets_itself=True,  # AG v0.1 loads it without self-collision (robots.md section 2)
    start_rotations={
        # AG v0.1 scratch_itch.py, bed_bathing.py: Euler (0, pi/2, 0), the hand along world +x
        "ScratchItch": (_H, 0.0, _H, 0.0),
        "BedBathing": (_H, 0.0, _H, 0.0),
        # AG v0.1 arm_manipulation.py: Euler (0, -pi/2, pi), along +x, turned by pi about it
        "ArmManipulation": (0.0, _H, 0.0, _H),
        # as Feeding (feeding.py): Euler (pi/2, 0, pi/2), along +x, fingers open vertically
        "Reaching": (0.5, 0.5, 0.5, 0.5),
        "Feeding": (0.5, 0.5, 0.5, 0.5),
        # AG v0.1 drinking.py: as ArmManipulation, the cup upright
        "Drinking": (0.0, _H, 0.0, _H),
        # AG v0.1 dressing.py: Euler (0, -pi/2, 0), the hand along world -x
        "Dressing": (_H, 0.0, -_H, 0.0),
    },
    # MIT. Its fingers are shorter than Assistive Gym's: ours stay primitives
    meshes=(
        MeshModel("robosuite", f"{ROBOSUITE}/robots/baxter/robot.xml", ("torso", "torso")),
        MeshPart(
            "robosuite",
            f"{ROBOSUITE}/bullet_data/baxter_description/meshes/base/PEDESTAL.stl",
            "pedestal",
            (0.2, 0.2, 0.2, 1.0),
        ),
        *gripper_meshes("left_gripper_base"),
        *gripper_meshes("right_gripper_base"),
    ),
)
