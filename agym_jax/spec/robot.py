"""Description of a robot: the names in its MJCF file, and where it starts for each task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from agym_jax.errors import SpecError

from .pose import Pose, Quat, Rgba, Vec3
from .task import Task


@dataclass(frozen=True)
class Arm:
    """One arm of a robot: joints in action order and the sites that locate its hand."""

    joints: tuple[str, ...]
    end_effector: str  # site: the link that Assistive Gym steers
    tool_frame: str  # site: canonical tool frame, z = approach, x = across the fingers
    gripper: tuple[str, ...]  # finger joints
    links: tuple[str, ...]  # collision geoms that may touch the person: hand, fingers, then inwards
    hand: int = 1  # how many of the links may touch furniture and the robot's trunk, too


@dataclass(frozen=True)
class BaseSearch:
    """Where a robot's base may stand for a task: a rectangle beside the person, and a yaw angle.

    AG v0.1 robots.md section 7: uniform within ``spread`` of the centre in y, and up to ``spread`` from the centre
    away from the person (towards ``side``) in x, turned by up to 30 degrees.
    """

    centre: Vec3  # world [m]
    spread: float = 0.5  # [m]
    side: float = -1.0  # which way is away from the person along x
    yaw: float = 0.0  # about which the base turns [rad]
    pivot: Vec3 = Pose().pos  # what is put there and turns on the spot, in the base's frame [m]
    requires_goals: bool = True  # whether ``Goal.required`` holds for this robot
    for_mouth: bool = False  # whether banks tell for which mouth a base was chosen


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class MeshModel:
    """Another package's model of the robot, MJCF or URDF, whose meshes can be used to draw it.

    Meshes are attached to the links with the same name in both models, which must have the same joints. Meshes on links
    that the robot lacks are attached to the nearest link that it has. See ``agym_jax.rendering.meshes``.
    """

    package: str  # on PyPI
    file: str  # of the package, beside its ``.dist-info``
    root: tuple[str, str]  # a link of that model, and the robot's that lies in the same place
    angles: Mapping[str, float] = field(default_factory=dict)  # joint there -> ours at 0, or held
    colours: Mapping[Rgba, Rgba] = field(default_factory=dict)  # there -> what is painted instead


@dataclass(frozen=True)
class MeshPart:
    """A mesh from another package, drawn on one of the robot's links: STL, OBJ or MSH, in metres."""

    package: str  # on PyPI
    file: str  # of the package, beside its ``.dist-info``
    link: str
    rgba: Rgba
    pose: Pose = Pose()  # of the file's frame in the link's


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class RobotSpec:
    """A robot: its MJCF model and the names in it that a scene needs."""

    name: str  # as in the environment ids
    model: str  # asset
    arms: Mapping[str, Arm]  # "left", "right"; one-armed robots give the same arm twice
    torso: str  # site that observations are relative to
    gripper_opening: Mapping[str, float]  # tool name -> finger joint position
    grasps: Mapping[str, Pose] = field(default_factory=dict)  # tool -> pose, over the tool's own
    bases: Mapping[str, Pose] = field(default_factory=dict)  # seat or task -> fixed base
    mounts: Mapping[str, str] = field(default_factory=dict)  # seat -> asset that carries the base
    solid_mounts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # seat -> its geoms
    mount_fronts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # for people's arms
    trunk: tuple[str, ...] = ()  # collision geoms that hand, tool and the helped arm may touch
    near_trunk: tuple[str, ...] = ()  # those besides the hand that may touch the trunk
    near_mount: tuple[str, ...] = ()  # those besides ``Arm.links`` that may touch a solid mount
    rest: Mapping[str, float] = field(default_factory=dict)  # joint not in use -> angle, else 0
    start_rotations: Mapping[str, Quat] = field(default_factory=dict)  # task -> hand orientation
    searches: Mapping[str, BaseSearch] = field(default_factory=dict)  # task -> where to look
    base_height: float = 0.0  # of the base of a robot that stands on the floor [m]
    endless: tuple[str, ...] = ()  # joints that AG's base search knows as without limits
    half_range: bool = False  # whether AG's inverse kinematics knows half of the joints' ranges
    half_turns: Mapping[str, float] = field(default_factory=dict)  # task -> -1: the other way round
    start_within: Mapping[str, float] = field(default_factory=dict)  # task -> [m], of fixed bases
    meets_itself: bool = False  # whether its start poses may have an arm in the robot's own body
    friction: float = 0.5  # of its material, see ``sim.contacts.pair_friction``
    meshes: tuple[MeshModel | MeshPart, ...] = ()  # what it may look like in pictures

    def arm(self, side: str) -> Arm:
        """Return the arm on one side.

        Raises:
            SpecError: if the robot has no arm on that side.
        """
        if side not in self.arms:
            raise SpecError(f"{self.name} has no {side!r} arm, only: {', '.join(self.arms)}.")
        return self.arms[side]

    def arms_for(self, task: Task) -> tuple[Arm, ...]:
        """Return the arms that a task uses, in action order; a one-armed robot always uses its only arm.

        Raises:
            SpecError: if the robot lacks an arm that the task requires.
        """
        return tuple(dict.fromkeys(self.arm(side) for side in task.arms))

    def fixed_base(self, task: Task) -> Pose | None:
        """Return the pose of the base for a task, or None if it is drawn from a bank of placements."""
        return self.bases.get(task.name, self.bases.get(task.seat.name))

    def base_search(self, task: str) -> BaseSearch:
        """Return the region in which to search for a base pose if the seat has no fixed one."""
        return self.searches.get(task, BaseSearch((-0.85, -0.4, self.base_height)))
