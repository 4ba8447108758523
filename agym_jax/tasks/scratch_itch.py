"""ScratchItch: find the itch on the person's right arm and scratch it gently.

Assistive Gym v0.1 ``scratch_itch.py`` (reference tasks.md section 2). The itch lies on the right upper arm or forearm and
moves with it. A scratch counts if the tool touches the person within 2.5 cm of the itch with less than 10 N, and more than
1 cm from where the last scratch counted. The task succeeds after 25 scratches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import WHEELCHAIR
from agym_jax.human.body import RIGHT_ARM, RIGHT_ARM_LINKS
from agym_jax.observe import column, observation, part
from agym_jax.preferences import PREFERENCE_TERMS, preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Control, Ending, HumanSpec, Measure, Pose, Preferences, SeatSpec, ToolSpec
from agym_jax.tasks.shared.assisted_arm import ArmFromChest, ArmFromTorso, see_arm

_H = math.sqrt(0.5)
_RAD = math.pi / 180.0


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [scratch_itch] unless noted otherwise.

    Attributes:
        distance: weight of the distance from tool to itch [1/m].
        action: weight of the squared action [1].
        tool_force: weight of the force at the itch [1/N].
        scratch: weight of the force of a scratch that counts [1/N].
        scratches: number of scratches required for success [1].
        target_radius: largest distance of a contact from the itch [m].
        stroke: smallest distance of a scratch from the previous one [m].
        gentle: largest force of a scratch that counts [N].
        preferences: weights of the human-preference terms.
    """

    distance: float = 1.0  # distance_weight
    action: float = 0.01  # action_weight
    tool_force: float = 0.01  # tool_force_weight
    scratch: float = 2.0  # scratch_reward_weight
    scratches: int = 25  # task_success_threshold
    target_radius: float = 0.025  # AG scratch_itch.py get_total_force
    stroke: float = 0.01  # AG scratch_itch.py step
    gentle: float = 10.0  # AG scratch_itch.py step
    preferences: Preferences = Preferences()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ItchState:
    """The itch of one episode and the scratches so far."""

    on_forearm: Array  # the limb: 0 upper arm, 1 forearm                       ()
    target_limb: Array  # the itch in the limb's frame [m]                     (3,)
    target_pos_w: Array  # the itch in the world, now [m]                      (3,)
    last_scratch_w: Array  # contact point of the last counted scratch [m]     (3,)
    scratches: Array  # how many counted                                       ()
    force_at_target: Array  # of the tool, near the itch [N]                   ()


@observation(source="scratch_itch.py:74")
class RobotObs:
    """Observation of the robot."""

    tool_pos_torso: Array = column(3, "m", "world axes, from the robot's torso")
    tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    tool_pos_target: Array = column(3, "m", "world axes, from the itch")
    target_pos_torso: Array = column(3, "m", "world axes, from the torso")
    arm_angles: Array = column(7, "rad", "joints")
    assisted_arm: ArmFromTorso = part(ArmFromTorso)  # shoulder, elbow, wrist
    tool_force: Array = column(1, "N", "sum over all contacts of the tool")


@observation(source="scratch_itch.py:79")
class HumanObs:
    """Observation of the active person."""

    tool_pos_human: Array = column(3, "m", "world axes, from the chest")
    tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    tool_pos_target: Array = column(3, "m", "world axes, from the itch")
    target_pos_human: Array = column(3, "m", "world axes, from the chest")
    human_angles: Array = column(10, "rad", "right arm's joints")
    assisted_arm: ArmFromChest = part(ArmFromChest)  # shoulder, elbow, wrist
    force_on_human: Array = column(1, "N", "tool and robot on the person")
    force_at_target: Array = column(1, "N", "tool on the itch")


SCRATCHER = ToolSpec(
    name="scratcher",
    model="tools/scratcher.xml",
    # AG: tool x along the approach, tool y = hand y, at 2 cm (robots.md section 9, Jaco)
    grasp=Pose((0.0, 0.0, 0.02), (_H, 0.0, -_H, 0.0)),
    tip="tool_tip",
    geoms=("scratcher_rod_collision", "scratcher_handle_collision"),
)


@dataclass(frozen=True)
class ScratchItch:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    name: str = "ScratchItch"
    # AG env.py and scratch_itch.py: 0.02 s x 5, gain 0.05 a step, 1 N m, 5 x 0.05 rad
    control: Control = Control(
        time_step=0.02, frame_skip=5, rate=0.05 / 0.02, max_torque=1.0, action_scale=0.25
    )
    gravity: float = -1.0  # AG scratch_itch.py reset: on the person only
    arms: tuple[str, ...] = ("left",)
    goals: tuple[tuple[str, ...], ...] = (RIGHT_ARM_LINKS,)
    tool: ToolSpec = SCRATCHER
    seat: SeatSpec = WHEELCHAIR
    human: HumanSpec = HumanSpec(
        joints=RIGHT_ARM,
        # AG scratch_itch.py reset: joints_positions
        pose={
            "r_shoulder_y": 30 * _RAD, "r_elbow_x": -90 * _RAD, "l_elbow_x": -90 * _RAD,
            "r_hip_x": -90 * _RAD, "r_knee_x": 80 * _RAD,
            "l_hip_x": -90 * _RAD, "l_knee_x": 80 * _RAD,
        },
        hold_rate=0.01 / 0.02,  # AG: reactive gain 0.01
        move_rate=0.05 / 0.02,  # AG: gain 0.05 for tremor and the active person
        max_torque=1.0,
        tremor_amplitude=10 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=("right_upper_arm", "right_forearm", "right_hand", "right_girdle",
               "chest", "waist", "head", "right_thigh"),
    )  # fmt: skip
    episode_length: int = 200
    reward_terms: tuple[str, ...] = (
        "distance",
        "action",
        "tool_force",
        "scratch",
        *PREFERENCE_TERMS,
    )
    measures: tuple[Measure, ...] = (Measure("scratches", "1", "scratches of the itch"),)
    endings: tuple[Ending, ...] = (
        Ending("never scratched", "scratches", high=1.0),
        Ending("1 to 12 scratches", "scratches", high=13.0),
        Ending("13 scratches or more", "scratches"),
    )
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, world [m] (1, 3). AG scratch_itch.py reset."""
        centre = jnp.array([[-0.5 if robot == "Jaco" else -0.55, 0.0, 0.8]])
        return centre + jax.random.uniform(key, (1, 3), minval=-0.05, maxval=0.05)

    def init(self, key: Array, sensed: Sensed) -> ItchState:
        """Draw the itch: a point on the skin of the upper arm or the forearm.

        AG scratch_itch.py generate_target: s in [radius, length] along the limb, any angle around it.
        """
        key_limb, key_along, key_around = jax.random.split(key, 3)
        on_forearm = jax.random.bernoulli(key_limb).astype(jnp.float32)
        d = sensed.dims
        length = jnp.where(on_forearm > 0, d.forearm_l, d.upper_arm_l)
        radius = jnp.where(on_forearm > 0, d.forearm_r, d.upper_arm_r)
        s = radius + (length - radius) * jax.random.uniform(key_along)
        angle = jax.random.uniform(key_around, maxval=2 * jnp.pi)
        local = jnp.stack([-radius * jnp.sin(angle), -radius * jnp.cos(angle), -s])
        state = ItchState(
            on_forearm=on_forearm,
            target_limb=local,
            target_pos_w=jnp.zeros(3),
            last_scratch_w=jnp.zeros(3),  # AG starts at the world's origin
            scratches=jnp.float32(0.0),
            force_at_target=jnp.float32(0.0),
        )
        return _follow_limb(state, sensed)

    def advance(self, state: ItchState, sensed: Sensed) -> tuple[ItchState, dict[str, Array]]:
        """Move the itch with the limb, and count a scratch if there was one."""
        c = self.config
        state = _follow_limb(state, sensed)
        tool = sensed.tool
        near = jnp.linalg.norm(tool.touch_pos_w - state.target_pos_w, axis=-1) < c.target_radius
        # the scratcher's tip and rod count, not its handle. AG get_total_force: links 0 and 1
        at_target = jnp.where(near, tool.touch_force * tool.touch_working, 0.0)
        force = jnp.sum(at_target)
        point = tool.touch_pos_w[jnp.argmax(at_target)]
        moved = jnp.linalg.norm(point - state.last_scratch_w) > c.stroke
        is_scratch = (force > 0.0) & moved & (force < c.gentle)
        state = replace(
            state,
            last_scratch_w=jnp.where(is_scratch, point, state.last_scratch_w),
            scratches=state.scratches + is_scratch,
            force_at_target=force,
        )
        return state, {"scratch": jnp.where(is_scratch, force, 0.0)}

    def rewards(
        self, state: ItchState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG scratch_itch.py step."""
        c = self.config
        distance = jnp.linalg.norm(state.target_pos_w - sensed.tool.pos_w)
        return {
            "distance": -c.distance * distance,
            "action": -c.action * jnp.sum(jnp.square(action)),
            "tool_force": c.tool_force * state.force_at_target,
            "scratch": c.scratch * events["scratch"],
            **preference_terms(
                c.preferences,
                jnp.linalg.norm(sensed.tool.vel_w),
                sensed.force_on_human,
                state.force_at_target,
            ),
        }

    def observe(self, state: ItchState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """Return the observations of robot and person."""
        s, tool, torso, chest = sensed, sensed.tool, sensed.torso_pos_w, sensed.human_pos_w
        arm_torso, arm_chest = see_arm(s)
        robot = RobotObs(
            tool_pos_torso=tool.pos_w - torso,
            tool_quat_w=tool.quat_w,
            tool_pos_target=tool.pos_w - state.target_pos_w,
            target_pos_torso=state.target_pos_w - torso,
            arm_angles=s.arm_angles,
            assisted_arm=arm_torso,
            tool_force=tool.force,
        )
        human = HumanObs(
            tool_pos_human=tool.pos_w - chest,
            tool_quat_w=tool.quat_w,
            tool_pos_target=tool.pos_w - state.target_pos_w,
            target_pos_human=state.target_pos_w - chest,
            human_angles=s.human_angles,
            assisted_arm=arm_chest,
            force_on_human=s.force_on_human,
            force_at_target=state.force_at_target,
        )
        return robot, human

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        return 5

    def privileged_obs(self, state: ItchState) -> Array:
        """Return where the last scratch counted, from the itch [m], how many have counted, and the force on the itch [N] (privileged_obs_size,)."""
        since = jnp.where(state.scratches > 0, state.last_scratch_w - state.target_pos_w, 0.0)
        return jnp.concatenate([since, jnp.stack([state.scratches, state.force_at_target])])

    def success(self, state: ItchState) -> Array:
        """Whether 25 scratches have counted ()."""
        return state.scratches >= self.config.scratches

    def measure(self, state: ItchState) -> dict[str, Array]:
        """Return the number of scratches that have counted."""
        return {"scratches": state.scratches}

    def markers(self, state: ItchState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return the points to draw: world position, radius [m], colour. AG: a cyan sphere of 1 cm."""
        return [(state.target_pos_w, 0.01, (0.0, 1.0, 1.0, 1.0))]


def _follow_limb(state: ItchState, sensed: Sensed) -> ItchState:
    """Return the itch in world coordinates, on the current pose of the limb."""
    on_forearm = state.on_forearm > 0
    upper, fore, _ = RIGHT_ARM_LINKS
    pos = jnp.where(on_forearm, sensed.link_pos_w[fore], sensed.link_pos_w[upper])
    rot = jnp.where(on_forearm, sensed.link_rot_w[fore], sensed.link_rot_w[upper])
    return replace(state, target_pos_w=pos + rot @ state.target_limb)


SCRATCH_ITCH = ScratchItch()
