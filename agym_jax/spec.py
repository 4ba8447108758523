"""Frozen records that describe robots, tools, seats, people and tasks, and the Task protocol.

A robot file and a task file hold nothing but these records and pure functions; ``scene.py`` turns them into a MuJoCo
model, ``env.py`` into an environment. Lengths in metres, angles in radians, quaternions wxyz, if not named otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import jax

from agym_jax.errors import SpecError

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Rgba = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """A rigid pose: position [m] and quaternion wxyz."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Quat = IDENTITY


@dataclass(frozen=True)
class Control:
    """How fast a task is controlled and simulated, and how strong its motors are.

    A motor asks for the joint velocity ``rate * (target - angle)`` under a torque bound, with the target
    one full displacement from the angle measured at the start of the control step; see ``sim.motors``.
    """

    time_step: float  # physics step [s]
    frame_skip: int  # physics steps in a control step
    rate: float  # AG's motor gain / solver sub-step [1/s]
    max_torque: float  # bound of a robot joint's torque [N m]
    action_scale: float  # target displacement of a full action [rad]

    def __post_init__(self) -> None:
        if self.frame_skip < 1 or self.time_step <= 0:
            raise SpecError(
                f"Control needs time_step > 0 and frame_skip >= 1, got {self.time_step}, {self.frame_skip}."
            )

    @property
    def period(self) -> float:
        """Length of a control step [s]."""
        return self.time_step * self.frame_skip


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
    """Where a robot's base may stand for a task: a rectangle beside the person, and a yaw.

    AG v0.1 robots.md section 7: uniform within ``spread`` of the centre in y, and within ``spread``
    of it away from the person (towards ``side`` in x), turned by up to 30 degrees.
    """

    centre: Vec3  # world [m]
    spread: float = 0.5  # [m]
    side: float = -1.0  # which way is away from the person along x
    yaw: float = 0.0  # about which the base turns [rad]
    pivot: Vec3 = Pose().pos  # what is put there and turns on the spot, in the base's frame [m]
    requires_goals: bool = True  # whether ``Goal.required`` holds for this robot


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class MeshModel:
    """Another package's model of the robot, MJCF or URDF, whose meshes it may wear in pictures.

    Links of one name in both wear them, and must have the same joints; what the package fixes to a link
    that the robot lacks goes with the nearest link that it has. See ``agym_jax.rendering.meshes``.
    """

    package: str  # on PyPI
    file: str  # of the package, beside its ``.dist-info``
    root: tuple[str, str]  # a link of that model, and the robot's that lies in the same place
    angles: Mapping[str, float] = field(default_factory=dict)  # joint there -> ours at 0, or held
    colours: Mapping[Rgba, Rgba] = field(default_factory=dict)  # there -> what is painted instead


@dataclass(frozen=True)
class MeshPart:
    """A mesh of another package on one of the robot's links: STL, OBJ or MSH, in metres."""

    package: str  # on PyPI
    file: str  # of the package, beside its ``.dist-info``
    link: str
    rgba: Rgba
    pose: Pose = Pose()  # of the file's frame in the link's


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class RobotSpec:
    """A robot: its MJCF and the names in it that a scene needs."""

    name: str  # as in the environment ids
    model: str  # asset
    arms: Mapping[str, Arm]  # "left", "right"; one-armed robots give the same arm twice
    torso: str  # site that observations are relative to
    gripper_opening: Mapping[str, float]  # tool name -> finger joint position
    grasps: Mapping[str, Pose] = field(default_factory=dict)  # tool -> pose, over the tool's own
    bases: Mapping[str, Pose] = field(default_factory=dict)  # seat or task -> fixed base
    mounts: Mapping[str, str] = field(default_factory=dict)  # seat -> asset that carries the base
    solid_mounts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # seat -> its geoms
    trunk: tuple[str, ...] = ()  # collision geoms of the robot that hand and tool may touch
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
        """The arm on one side; raises SpecError if the robot lacks it."""
        if side not in self.arms:
            raise SpecError(f"{self.name} has no {side!r} arm, only: {', '.join(self.arms)}.")
        return self.arms[side]

    def arms_for(self, task: Task) -> tuple[Arm, ...]:
        """The arms that a task uses, in action order; a one-armed robot serves with its one.

        Raises:
            SpecError: the robot lacks an arm that the task asks for.
        """
        return tuple(dict.fromkeys(self.arm(side) for side in task.arms))

    def fixed_base(self, task: Task) -> Pose | None:
        """Where the base stands for a task, or None if a bank of placements says so."""
        return self.bases.get(task.name, self.bases.get(task.seat.name))

    def base_search(self, task: str) -> BaseSearch:
        """Where to look for a base when the seat has no fixed one."""
        return self.searches.get(task, BaseSearch((-0.85, -0.4, self.base_height)))


@dataclass(frozen=True)
class ToolSpec:
    """A tool held rigidly in the hand.

    Its geoms touch the person. Several capsules may stand for one part that is not round: they count as one contact, with
    the sum of their forces at the centre of pressure. A tool that has many of them has an ``outline``: one
    capsule that touches everything but the arm that is helped, in their place.
    """

    name: str
    model: str  # asset
    grasp: Pose  # of the tool in the canonical tool frame
    tip: str  # site that the task calls the tool's position
    geoms: tuple[str, ...]  # collision geoms, capsules and spheres, the working ones first
    n_working: int = 1  # how many of them do the work
    parts: tuple[int, ...] = ()  # how many geoms, in order, make up each part; () is one each
    outline: str = ""  # collision geom for other limbs and the seat; "" is the working ones
    friction: float = 0.5  # of its material, see ``sim.contacts.pair_friction``


@dataclass(frozen=True)
class Prop:
    """A thing that stands near the seat: seen, and kept clear of by start placements, not felt."""

    name: str  # of its file's root body
    model: str  # asset
    pose: Pose = Pose()  # in the world


@dataclass(frozen=True)
class SeatSpec:
    """What the person sits or lies on, in world coordinates."""

    name: str
    model: str  # asset
    geoms: tuple[str, ...]  # collision geoms that a tool, hand or limb may touch
    friction: float = 0.5  # of its material, see ``sim.contacts.pair_friction``
    front: tuple[Vec3, Vec3] | None = None  # where the camera "front" stands and looks, world [m]
    bears_upper_arm: bool = False  # whether the upper arm may rest on it, not only forearm and hand
    rolling: float = 0.0  # rolling and spinning friction of its material with whom it bears [m]
    pillow: tuple[str, ...] = ()  # collision geoms that bear the girdle, if also the upper arm
    props: tuple[Prop, ...] = ()  # what stands around it


@dataclass(frozen=True)
class Goal:
    """What a hand should be able to reach from where the base stands, besides the start of the episode."""

    link: str  # of the person, or "mouth"
    above: float = 0.0  # it [m]
    yaw: float | None = None  # z turn from the start's orientation [rad]; None leaves it free
    required: bool = False  # a base that does not reach it is discarded

    @classmethod
    def of(cls, goal: Goal | str) -> Goal:
        """An entry of ``Task.goals``, where a link's name stands for its position."""
        return goal if isinstance(goal, Goal) else cls(goal)


PassiveMode = Literal["hold", "limp", "frozen", "welded"]
"""Who does not act holds the pose with weak muscles, lets the limbs hang, only trembles, or does not move."""


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class HumanSpec:
    """The person's part in a task: which joints move, from which pose, and how strongly."""

    joints: tuple[str, ...]  # controllable joints, in action order
    pose: Mapping[str, float]  # joint -> angle [rad]; the others 0, all clamped to the limits
    hold_rate: float  # rate of a person who holds still [1/s]
    move_rate: float  # rate of an active or trembling person [1/s]
    max_torque: float  # of a person of full strength [N m]
    tremor_amplitude: float  # bound of the uniform draw per joint [rad]
    impairments: tuple[str, ...]  # drawn uniformly
    limbs: tuple[str, ...]  # person bodies that tool and robot may touch
    arm: str = "right"  # the arm that is helped
    passive_mode: PassiveMode = "hold"  # what a person who does not act does
    postures: str = ""  # bank of settled postures that replaces ``pose``, see person.posture
    pose_range: Mapping[str, float] = field(default_factory=dict)  # joint -> uniform draw +- [rad]
    links: tuple[str, ...] = ()  # further links whose poses the task asks for
    friction: float = 0.5  # of skin, see ``sim.contacts.pair_friction``

    def moving(self, active: bool) -> tuple[str, ...]:
        """Joints that are hinges in the scene, in action order."""
        return () if self.passive_mode == "welded" and not active else self.joints


@dataclass(frozen=True)
class Preferences:
    """Weights of the human-preference terms. AG v0.1 config.ini [human_preferences]."""

    velocity: float = 0.25
    force_nontarget: float = 0.01
    high_forces: float = 0.05
    food_hit: float = 1.0
    food_velocities: float = 1.0
    dressing_force: float = 0.01


class Task(Protocol):
    """A task: data for the scene, and pure functions of what one control step shows."""

    @property
    def name(self) -> str:
        """As in the environment ids."""
        ...

    @property
    def control(self) -> Control:
        """Rates and motors."""
        ...

    @property
    def gravity(self) -> float:
        """World z [m/s^2], on the person only."""
        ...

    @property
    def arms(self) -> tuple[str, ...]:
        """Sides of the robot's arms that work, in action order."""
        ...

    @property
    def tool(self) -> ToolSpec | None:
        """What each of those hands holds, if anything."""
        ...

    @property
    def goals(self) -> tuple[tuple[Goal | str, ...], ...]:
        """For each arm, what its hand should be able to reach; a string is a ``Goal.link``."""
        ...

    @property
    def seat(self) -> SeatSpec:
        """What the person sits or lies on."""
        ...

    @property
    def human(self) -> HumanSpec:
        """The person's part."""
        ...

    @property
    def episode_length(self) -> int:
        """Control steps of an episode."""
        ...

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of what ``rewards`` returns, in its order."""
        ...

    @property
    def robot_obs(self) -> type:
        """Observation record of the robot."""
        ...

    @property
    def human_obs(self) -> type:
        """Observation record of the person."""
        ...

    def start(self, key: jax.Array, robot: str) -> jax.Array:
        """Where the robot's hands start, world [m] (n_arms, 3)."""
        ...

    def init(self, key: jax.Array, sensed: Any) -> Any:
        """Draw the episode's goal; returns the task's own pytree."""
        ...

    def advance(self, state: Any, sensed: Any) -> tuple[Any, dict[str, jax.Array]]:
        """Bookkeeping of one control step; returns the new state and this step's events."""
        ...

    def rewards(self, state: Any, events: dict, sensed: Any, action: jax.Array) -> dict:
        """Named reward terms, already weighted; their sum is the reward."""
        ...

    def observe(self, state: Any, sensed: Any) -> tuple[Any, Any]:
        """Robot's and person's observation records."""
        ...

    def success(self, state: Any) -> jax.Array:
        """Whether the episode counts as a success so far ()."""
        ...

    def markers(self, state: Any) -> list[Any]:
        """Points to draw: world positions [m] (3,) or (n, 3), radius [m], colour; NaN is not drawn."""
        ...


@runtime_checkable
class Privileged(Protocol):
    """What a task has besides if rewards to come depend on more than is observed."""

    @property
    def privileged_obs_size(self) -> int:
        """Entries of ``privileged_obs``."""
        ...

    def privileged_obs(self, state: Any) -> jax.Array:
        """What nobody observes; for value functions, in training only (privileged_obs_size,)."""
        ...


@runtime_checkable
class Loaded(Protocol):
    """What a task has besides if its tool weighs on the arm that holds it."""

    def load(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Weight of the first tool and what is in it [N] (), and where it acts, world [m] (3,)."""
        ...


@dataclass(frozen=True)
class Surface:
    """A triangle mesh to draw, seen from both sides."""

    vertices: Any  # world [m]                                              (n, 3)
    triangles: Any  # vertices of each                                      (t, 3)
    rgba: tuple[float, float, float, float]


@runtime_checkable
class Surfaced(Protocol):
    """What a task has besides if it draws more than points."""

    def surfaces(self, state: Any) -> list[Surface]:
        """Meshes to draw; their triangles are the same in every state."""
        ...


@runtime_checkable
class Prepared(Protocol):
    """What a task has besides if it makes something of its data before the first episode: a mesh of a file."""

    def prepare(self) -> None:
        """Make it, and refuse data that it cannot be made of; called whenever a scene is built.

        Raises:
            AgymError: says what is wrong where.
        """
        ...


@runtime_checkable
class Furnished(Protocol):
    """What a task has besides if some of its seat's props stand elsewhere in every episode."""

    def props(self, state: Any) -> dict[str, jax.Array]:
        """Name of a prop -> where it stands, world [m] (3,)."""
        ...
