"""ArmManipulation: lift the limp right arm, which hangs over the side of the bed, onto the person's body.

Assistive Gym v0.1 ``arm_manipulation.py`` (reference tasks.md section 7). A robot with two arms uses two scoopers. The
task succeeds if at any time in the episode the elbow is near the waist and the hand near the hips: the sum of these two
distances is at most 0.7 m.

DEVIATION(one-arm): Sawyer and Jaco take 7 actions, not 14 of which AG ignores 7; their one tool stands in
both places of the observation (its force, as in AG, in the right one's alone), and its force and speed count once.
DEVIATION(arm-torque): motors reach 10 N m, AG's 5. The person's mass lies where the body is, so that
lifting the outstretched arm takes 12.6 N m about the shoulder; with AG's centres of mass at the joints
it takes 6.9. Where episodes begin a Jaco's tool lifts 15 N (median) with 5 N m and 29 N with 10, a Sawyer's 9 and 18;
a man's forearm, hand and half his upper arm weigh 32 N. The Jaco that shipped until 26 November 2026 learned
with AG's masses and motors of 5 N m (``--humans.masses ag --robot.strength 0.5 0.5``, four seeds of 97.5 to 99.2 %): it helps in 23 of 40 episodes
of AG (in 29 of the 40 others over which it was compared with those that follow), and here in 81 % of 1,000 (in 99 % before a limp arm on the bed's edge withstood pushes as in AG, ``bed-contact``; it was not trained with that arm).
Continued with that arm, masses and motors, it helped in 47 of 60 episodes of AG. Continued also with scoopers that turn on the bed nearly as little as in AG (``bed-contact``), Sawyer's helps in 37 of 40, and Baxter's and PR2's
helped in 2 of 20 and 18 of 40. From nothing, with such scoopers, our masses and 10 N m, Jaco's, Baxter's and PR2's policies that ship help in 36 of 40, 25 of 40 and 12 of 20. A policy of Jaco that learned with our masses and 10 N m helped in 5 of 20, in 12 if AG's motors reach 10 N m, and one that learned with
both masses and 5 to 10 N m in 9 of 20. What failed in AG with the policy of Jaco that shipped until 26 November 2026 were mostly arms of women that
stay on the bed's edge, so that the tool sinks into them (``bed-contact``). Starts with the robot inside the nightstand (``nightstand``) do not explain the failures: if the robot
does not collide with it in AG, the former policy of Jaco helps in 29 of those 40 episodes, too.
DEVIATION(pressure): a scooper's pressure is its force over the number of its parts' contacts; AG counts
Bullet's closest points within 1 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import BED
from agym_jax.human.body import RIGHT_ARM, RIGHT_ARM_LINKS
from agym_jax.observe import column, observation, part
from agym_jax.preferences import PREFERENCE_TERMS, preference_terms
from agym_jax.sense import Sensed, ToolSensed
from agym_jax.spec import Control, Ending, HumanSpec, Measure, Pose, Preferences, SeatSpec, ToolSpec
from agym_jax.tasks.shared.assisted_arm import ArmFromChest, ArmFromTorso, see_arm

_RAD = math.pi / 180.0


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [arm_manipulation] unless noted otherwise.

    Attributes:
        distance_human: weight of the distances from elbow to waist and from hand to hips [1/m].
        distance_tool: weight of the distance from each tool to the arm [1/m].
        action: weight of the squared action [1].
        close: negative sum of the two distances above which the arm counts as being in place [m].
        pressure: weight of high pressures [1/N].
        preferences: weights of the human-preference terms.
    """

    distance_human: float = 0.5  # distance_human_weight
    distance_tool: float = 0.25  # distance_end_effector_weight
    action: float = 0.01  # action_weight
    close: float = -0.7  # task_success_threshold
    pressure: float = 0.01  # [human_preferences] high_pressures_weight
    preferences: Preferences = Preferences()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ArmState:
    """How close the arm is to its target place."""

    nearness: Array  # minus elbow to waist minus hand to hips [m]             ()
    best: Array  # the greatest so far [m]                                     ()


@observation(source="arm_manipulation.py:83")
class RobotObs:
    """Observation of the robot."""

    left_tool_pos_torso: Array = column(3, "m", "world axes, from the robot's torso")
    left_tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    right_tool_pos_torso: Array = column(3, "m", "world axes, from the torso")
    right_tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    arm_angles: Array = column(14, "rad", "left arm, then right")
    assisted_arm: ArmFromTorso = part(ArmFromTorso)  # shoulder, elbow, wrist
    waist_pos_torso: Array = column(3, "m", "world axes, from the torso")
    hips_pos_torso: Array = column(3, "m", "world axes, from the torso")
    left_tool_force: Array = column(1, "N", "all contacts of the tool; 0 with one arm")
    right_tool_force: Array = column(1, "N", "all contacts of the tool")


@observation(source="arm_manipulation.py:89")
class HumanObs:
    """Observation of the active person."""

    left_tool_pos_human: Array = column(3, "m", "world axes, from the chest")
    left_tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    right_tool_pos_human: Array = column(3, "m", "world axes, from the chest")
    right_tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    human_angles: Array = column(10, "rad", "right arm's joints")
    assisted_arm: ArmFromChest = part(ArmFromChest)  # shoulder, elbow, wrist
    waist_pos_human: Array = column(3, "m", "world axes, from the chest")
    hips_pos_human: Array = column(3, "m", "world axes, from the chest")
    force_on_human: Array = column(1, "N", "robot and tools on the person")
    left_tool_on_human: Array = column(1, "N", "tool on the person; 0 with one arm")
    right_tool_on_human: Array = column(1, "N", "tool on the person")


SCOOPER = ToolSpec(
    name="scooper",
    model="tools/scooper.xml",
    grasp=Pose(),
    tip="tool_tip",
    geoms=tuple(f"scooper_{i}_collision" for i in range(1, 7)),
    n_working=6,
)


@dataclass(frozen=True)
class ArmManipulation:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    name: str = "ArmManipulation"
    # AG env.py and arm_manipulation.py: 0.02 s x 5, gain 0.05 a step, 5 x 0.05 rad; 5 N m, see above
    control: Control = Control(
        time_step=0.02, frame_skip=5, rate=0.05 / 0.02, max_torque=10.0, action_scale=0.25
    )
    gravity: float = -9.81  # AG arm_manipulation.py reset: on the person only
    arms: tuple[str, ...] = ("left", "right")
    goals: tuple[tuple[str, ...], ...] = (("right_forearm", "waist"), ("right_hand", "hips"))
    tool: ToolSpec = SCOOPER
    # AG arm_manipulation.py reset: after the first of its two settles; limb_rolling, tool_rolling: deviation bed-contact
    seat: SeatSpec = replace(
        BED, friction=0.3, rolling=0.3, bears_upper_arm=True, limb_rolling=0.28, tool_rolling=0.6
    )
    human: HumanSpec = HumanSpec(
        joints=RIGHT_ARM,
        pose={},
        postures="ArmManipulation",
        hold_rate=0.05 / 0.02,
        move_rate=0.05 / 0.02,
        max_torque=2.0,  # AG: of the active person; a still one's arm is limp
        tremor_amplitude=0.0,
        impairments=("none", "limits", "weakness"),
        limbs=("right_upper_arm", "right_forearm", "right_hand", "chest", "waist", "hips",
               "right_thigh"),
        passive_mode="limp",
    )  # fmt: skip
    episode_length: int = 200
    # an estimate: forearm, hand and half of the upper arm weigh 32 N, and as much may go into moving and stopping them
    comfort: tuple[tuple[str, float], ...] = tuple(
        (name, 60.0) for name in ("upper arm", "forearm", "hand")
    )
    reward_terms: tuple[str, ...] = (
        "distance_human", "distance_tools", "action", *PREFERENCE_TERMS, "preference_high_pressures",
    )  # fmt: skip
    measures: tuple[Measure, ...] = (
        Measure("distance", "m", "from elbow to waist and from hand to hips, both together"),
    )
    endings: tuple[Ending, ...] = (
        Ending("arm farther than 1 m", "distance", low=1.0),
        Ending("arm within 1 m", "distance"),
    )
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def start(self, key: Array, robot: str) -> Array:
        """Return the start positions of the hands, world [m] (2, 3). AG arm_manipulation.py reset."""
        left = (-0.9, 0.4, 1.0) if robot == "Jaco" else (-0.9, 0.7, 0.8)
        centre = jnp.array([left, (-0.9, -0.3, 0.8)])
        return centre + jax.random.uniform(key, (2, 3), minval=-0.05, maxval=0.05)

    def init(self, key: Array, sensed: Sensed) -> ArmState:
        """Initialise the best value; nothing is drawn. It counts from the first step, as in AG."""
        return ArmState(_nearness(sensed), jnp.float32(-jnp.inf))

    def advance(self, state: ArmState, sensed: Sensed) -> tuple[ArmState, dict[str, Array]]:
        """Update the best value so far."""
        nearness = _nearness(sensed)
        return ArmState(nearness, jnp.maximum(state.best, nearness)), {}

    def rewards(
        self, state: ArmState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG arm_manipulation.py step."""
        c, s = self.config, sensed
        _, elbow, hand = (s.link_pos_w[name] for name in RIGHT_ARM_LINKS)
        goals = (elbow, hand)[: len(s.tools)]
        apart = [jnp.linalg.norm(t.pos_w - g) for t, g in zip(s.tools, goals, strict=True)]
        speeds = [jnp.linalg.norm(t.vel_w) for t in s.tools]
        pressures = [_pressure(t) for t in s.tools]
        return {
            "distance_human": c.distance_human * state.nearness,
            # one tool counts for both, as in AG
            "distance_tools": -2.0 * c.distance_tool * jnp.mean(jnp.stack(apart)),
            "action": -c.action * jnp.sum(jnp.square(action)),
            **preference_terms(
                c.preferences,
                jnp.sum(jnp.stack(speeds)),
                s.robot_on_human,  # the scoopers' touch is wanted
                jnp.float32(0.0),
            ),
            "preference_high_pressures": -c.pressure * jnp.sum(jnp.stack(pressures)),
        }

    def observe(self, state: ArmState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """Return the observations of robot and person."""
        s, torso, chest = sensed, sensed.torso_pos_w, sensed.human_pos_w
        left, right = s.tools[0], s.tools[-1]
        # AG counts contacts of a one-armed robot's tool as the right one's
        two = float(len(s.tools) > 1)
        arm_torso, arm_chest = see_arm(s)
        waist, hips = s.link_pos_w["waist"], s.link_pos_w["hips"]
        robot = RobotObs(
            left_tool_pos_torso=left.pos_w - torso,
            left_tool_quat_w=left.quat_w,
            right_tool_pos_torso=right.pos_w - torso,
            right_tool_quat_w=right.quat_w,
            arm_angles=jnp.tile(s.arm_angles, 2)[:14],
            assisted_arm=arm_torso,
            waist_pos_torso=waist - torso,
            hips_pos_torso=hips - torso,
            left_tool_force=two * left.force,
            right_tool_force=right.force,
        )
        human = HumanObs(
            left_tool_pos_human=left.pos_w - chest,
            left_tool_quat_w=left.quat_w,
            right_tool_pos_human=right.pos_w - chest,
            right_tool_quat_w=right.quat_w,
            human_angles=s.human_angles,
            assisted_arm=arm_chest,
            waist_pos_human=waist - chest,
            hips_pos_human=hips - chest,
            force_on_human=s.force_on_human,
            left_tool_on_human=two * left.on_human,
            right_tool_on_human=right.on_human,
        )
        return robot, human

    def success(self, state: ArmState) -> Array:
        """Whether the arm has been in place at any time in the episode ()."""
        return state.best >= self.config.close

    def measure(self, state: ArmState) -> dict[str, Array]:
        """Return the current distances of the arm from its target place."""
        return {"distance": -state.nearness}

    def markers(self, state: ArmState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return no markers, as in AG."""
        return []


def _nearness(sensed: Sensed) -> Array:
    """Return the negative sum of the distances from elbow to waist and from hand to hips [m] ()."""
    _, elbow, hand = (sensed.link_pos_w[name] for name in RIGHT_ARM_LINKS)
    to_waist = jnp.linalg.norm(elbow - sensed.link_pos_w["waist"])
    return -to_waist - jnp.linalg.norm(hand - sensed.link_pos_w["hips"])


def _pressure(tool: ToolSensed) -> Array:
    """Return the force of a scooper on the person divided by the number of its contacts [N] ()."""
    touching = jnp.sum(tool.touch_force > 0)
    return tool.on_human / jnp.maximum(touching, 1)


ARM_MANIPULATION = ArmManipulation()
