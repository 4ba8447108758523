"""Description of a task: records for the tool, the seat and the person's role, and the protocol of its functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import jax

from agym_jax.errors import SpecError

from .pose import Pose, Vec3


@dataclass(frozen=True)
class Control:
    """Control rate, physics step and motor strength of a task.

    A motor drives its joint at the velocity ``rate * (target - angle)``, subject to a torque limit. The target of a full
    action is ``action_scale`` away from the angle measured at the start of the control step; see ``sim.motors``.
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
class ToolSpec:
    """A tool held rigidly in the hand.

    Its geoms can touch the person. Several capsules may approximate one part that is not round: they count as one contact,
    with the sum of their forces at the centre of pressure. A tool with many such capsules has an ``outline``: a single
    capsule that replaces them in contacts with everything except the assisted arm.
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
    """An object near the seat: it is drawn and avoided by start placements, but has no contacts."""

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
    stops_arm: bool = False  # whether the robot's wrist and forearm meet it, not only its hand
    bears_upper_arm: bool = False  # whether the upper arm may rest on it, not only forearm and hand
    rolling: float = 0.0  # rolling and spinning friction of its material [m]
    limb_rolling: float | None = None  # of a limb and the seat together [m]; None: by material
    tool_rolling: float | None = None  # the same of a tool or the robot and the seat [m]
    pillow: tuple[str, ...] = ()  # collision geoms that bear the girdle, if also the upper arm
    outline: tuple[str, ...] = ()  # further geoms that tools and robots may touch, but no limb
    props: tuple[Prop, ...] = ()  # what stands around it


@dataclass(frozen=True)
class Goal:
    """A target that a hand should be able to reach from the base, besides its start pose in the episode."""

    link: str  # of the person, or "mouth"
    above: float = 0.0  # it [m]
    yaw: float | None = None  # z turn from the start's orientation [rad]; None leaves it free
    required: bool = False  # a base that does not reach it is discarded

    @classmethod
    def of(cls, goal: Goal | str) -> Goal:
        """Convert an entry of ``Task.goals``, where the name of a link stands for its position."""
        return goal if isinstance(goal, Goal) else cls(goal)


PassiveMode = Literal["hold", "limp", "frozen", "welded"]
"""What a passive person does: hold the pose with weak muscles, let the limbs hang, only tremble, or not move at all."""


@dataclass(frozen=True, eq=False)  # has dicts in it: equal if identical
class HumanSpec:
    """The person's role in a task: which joints move, from which pose, and how strongly."""

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
        """Return the joints that are hinges in the scene, in action order."""
        return () if self.passive_mode == "welded" and not active else self.joints


@dataclass(frozen=True)
class Preferences:
    """Weights of the human-preference terms. AG v0.1 config.ini [human_preferences].

    Attributes:
        velocity: weight of the speed of the tool or hand [s/m].
        force_nontarget: weight of forces on the person where no help is needed [1/N].
        high_forces: weight of forces of 10 N or more where help is needed [1/N].
        food_hit: cost of each particle of food or water that hits the person [1].
        food_velocities: weight of the speed of particles that enter the mouth [s/m].
        dressing_force: weight of the garment's forces on the person [1/N].
    """

    velocity: float = 0.25
    force_nontarget: float = 0.01
    high_forces: float = 0.05
    food_hit: float = 1.0
    food_velocities: float = 1.0
    dressing_force: float = 0.01


class Task(Protocol):
    """A task: data for the scene, and pure functions of the sensed data of each control step."""

    @property
    def name(self) -> str:
        """Name, as in the environment ids."""
        ...

    @property
    def control(self) -> Control:
        """Control rates and motors."""
        ...

    @property
    def gravity(self) -> float:
        """Gravity along the world's z axis [m/s^2], which acts on the person only."""
        ...

    @property
    def arms(self) -> tuple[str, ...]:
        """Sides of the robot arms that the task uses, in action order."""
        ...

    @property
    def tool(self) -> ToolSpec | None:
        """Tool that each of those hands holds, if any."""
        ...

    @property
    def goals(self) -> tuple[tuple[Goal | str, ...], ...]:
        """Targets that each arm's hand should be able to reach; a string is a ``Goal.link``."""
        ...

    @property
    def seat(self) -> SeatSpec:
        """Seat or bed of the person."""
        ...

    @property
    def human(self) -> HumanSpec:
        """The person's role."""
        ...

    @property
    def episode_length(self) -> int:
        """Control steps per episode."""
        ...

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the terms that ``rewards`` returns, in the same order."""
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
        """Return the start positions of the robot's hands, world [m] (n_arms, 3)."""
        ...

    def init(self, key: jax.Array, sensed: Any) -> Any:
        """Draw the episode's goal; returns the task's state, a pytree of its own."""
        ...

    def advance(self, state: Any, sensed: Any) -> tuple[Any, dict[str, jax.Array]]:
        """Update the task's state after a control step; returns the new state and this step's events."""
        ...

    def rewards(self, state: Any, events: dict, sensed: Any, action: jax.Array) -> dict:
        """Return the named reward terms, already weighted; their sum is the reward."""
        ...

    def observe(self, state: Any, sensed: Any) -> tuple[Any, Any]:
        """Return the observation records of the robot and of the person."""
        ...

    def success(self, state: Any) -> jax.Array:
        """Return whether the episode counts as a success so far ()."""
        ...

    def markers(self, state: Any) -> list[Any]:
        """Return points to draw: world positions [m] (3,) or (n, 3), radius [m], colour; NaN positions are not drawn."""
        ...
