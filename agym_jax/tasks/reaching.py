"""Reaching: bring the robot's hand to the person's mouth. This is the tutorial's task, without a tool.

Assistive Gym v0.1's wiki, "Creating a New Assistive Environment" (reference tasks.md section 8).
``docs/create_an_environment.md`` walks through this file.

DEVIATION(reaching-success): success is a hand within 3 cm of the mouth; the tutorial's code compares
the negative distance, which always succeeds.
DEVIATION(reaching-speed): the speed is that of the hand which reaches; the tutorial reads the PR2's
other one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import WHEELCHAIR
from agym_jax.human.body import HEAD
from agym_jax.observe import column, observation
from agym_jax.preferences import PREFERENCE_TERMS, preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Control, Ending, Goal, HumanSpec, Measure, Preferences, SeatSpec

_RAD = math.pi / 180.0


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. The tutorial's [reaching] section.

    Attributes:
        distance: weight of the distance from hand to mouth [1/m].
        reached: distance from hand to mouth within which the task succeeds [m].
        preferences: weights of the human-preference terms.
    """

    distance: float = 1.0  # distance_weight
    reached: float = 0.03  # task_success_threshold
    preferences: Preferences = Preferences()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ReachState:
    """The position of the mouth and the distance of the hand from it."""

    mouth_pos_w: Array  # [m]                                                  (3,)
    distance: Array  # [m]                                                     ()


@observation(source="wiki tutorial")
class RobotObs:
    """Observation of the robot."""

    hand_pos_torso: Array = column(3, "m", "world axes, from the robot's torso")
    hand_pos_mouth: Array = column(3, "m", "world axes, from the mouth")
    arm_angles: Array = column(7, "rad", "joints")
    hand_quat_w: Array = column(4, "1 (wxyz)", "world")
    head_quat_w: Array = column(4, "1 (wxyz)", "world")


@observation(source="wiki tutorial")
class HumanObs:
    """Observation of the active person."""

    hand_pos_human: Array = column(3, "m", "world axes, from the chest")
    hand_pos_mouth: Array = column(3, "m", "world axes, from the mouth")
    human_angles: Array = column(4, "rad", "neck and head joints")
    hand_quat_w: Array = column(4, "1 (wxyz)", "world")
    head_quat_w: Array = column(4, "1 (wxyz)", "world")
    force_on_human: Array = column(1, "N", "robot on the person")


@dataclass(frozen=True)
class Reaching:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    name: str = "Reaching"
    # 0.02 s x 5, gain 0.05 a step, 1 N m, 5 x 0.05 rad
    control: Control = Control(
        time_step=0.02, frame_skip=5, rate=0.05 / 0.02, max_torque=1.0, action_scale=0.25
    )
    gravity: float = 0.0  # on the person only
    arms: tuple[str, ...] = ("right",)
    goals: tuple[tuple[Goal, ...], ...] = ((Goal("mouth", required=True), Goal("mouth")),)
    tool: None = None
    seat: SeatSpec = WHEELCHAIR
    human: HumanSpec = HumanSpec(
        joints=HEAD,
        pose={
            "r_elbow_x": -90 * _RAD, "l_elbow_x": -90 * _RAD, "r_hip_x": -90 * _RAD,
            "r_knee_x": 80 * _RAD, "l_hip_x": -90 * _RAD, "l_knee_x": 80 * _RAD,
        },
        pose_range={"head_x": 30 * _RAD, "head_y": 30 * _RAD, "head_z": 30 * _RAD},
        hold_rate=0.05 / 0.02,
        move_rate=0.05 / 0.02,
        max_torque=1.0,
        tremor_amplitude=20 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=("head", "neck", "chest", "waist", "right_girdle", "left_girdle",
               "right_upper_arm", "right_forearm", "right_hand"),
        passive_mode="frozen",
    )  # fmt: skip
    episode_length: int = 200
    reward_terms: tuple[str, ...] = ("distance", *PREFERENCE_TERMS)
    measures: tuple[Measure, ...] = (Measure("distance", "m", "from hand to mouth"),)
    endings: tuple[Ending, ...] = (
        Ending("hand within 5 cm", "distance", high=0.05),
        Ending("hand farther away", "distance"),
    )
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, world [m] (1, 3)."""
        centre = jnp.array([[-0.15, -0.4, 1.0]])
        return centre + jax.random.uniform(key, (1, 3), minval=-0.05, maxval=0.05)

    def init(self, key: Array, sensed: Sensed) -> ReachState:
        """Set the goal: the mouth, whichever way the head is turned."""
        return ReachState(sensed.mouth_pos_w, _distance(sensed))

    def advance(self, state: ReachState, sensed: Sensed) -> tuple[ReachState, dict[str, Array]]:
        """Update the positions of hand and mouth."""
        return ReachState(sensed.mouth_pos_w, _distance(sensed)), {}

    def rewards(
        self, state: ReachState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms."""
        c = self.config
        return {
            "distance": -c.distance * state.distance,
            **preference_terms(
                c.preferences,
                jnp.linalg.norm(sensed.tool.vel_w),
                sensed.force_on_human,
                jnp.float32(0.0),
            ),
        }

    def observe(self, state: ReachState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """Return the observations of robot and person."""
        hand, head = sensed.tool, sensed.link_quat_w["head"]
        to_mouth = hand.pos_w - state.mouth_pos_w
        robot = RobotObs(
            hand_pos_torso=hand.pos_w - sensed.torso_pos_w,
            hand_pos_mouth=to_mouth,
            arm_angles=sensed.arm_angles,
            hand_quat_w=hand.quat_w,
            head_quat_w=head,
        )
        human = HumanObs(
            hand_pos_human=hand.pos_w - sensed.human_pos_w,
            hand_pos_mouth=to_mouth,
            human_angles=sensed.human_angles,
            hand_quat_w=hand.quat_w,
            head_quat_w=head,
            force_on_human=sensed.force_on_human,
        )
        return robot, human

    def success(self, state: ReachState) -> Array:
        """Whether the hand is at the mouth now ()."""
        return state.distance <= self.config.reached

    def measure(self, state: ReachState) -> dict[str, Array]:
        """Return the distance from the hand to the mouth."""
        return {"distance": state.distance}

    def markers(self, state: ReachState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return the points to draw: a green sphere of 1 cm at the mouth."""
        return [(state.mouth_pos_w, 0.01, (0.0, 1.0, 0.0, 1.0))]


def _distance(sensed: Sensed) -> Array:
    return jnp.linalg.norm(sensed.tool.pos_w - sensed.mouth_pos_w)


REACHING = Reaching()
