"""BedBathing: wipe the right arm of a person lying in bed.

Assistive Gym v0.1 ``bed_bathing.py`` (reference tasks.md section 3). Points cover the skin of the upper arm and the
forearm in rings, including the underside. When the pad touches the person, it wipes all points within 2.5 cm of the
contact. The task succeeds when 30 % of the points have been wiped. Neither agent observes which points are left.

DEVIATION(wiper-shape): pad and plate are the rims of their lower faces, 1 mm thick; a sphere sinks 2 mm into the pad's
face. All contacts of the pad with one limb count as one, at their centre of pressure: Bullet has one. It also counts
contacts up to 0.6 mm apart, which bear no force: in the recorded presses AG wipes 0.83 points, ours 0.72.
DEVIATION(wiper-force): an active person observes the force of the whole wiper, as a robot does, AG's person that of its pad. On chest, head and legs
the wiper is its outline, all of whose force counts as not wanted; AG's pad is wanted there too, below 10 N.
DEVIATION(bathing-tremor): a still person is welded to the bed, tremor included, as in AG.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.errors import SpecError
from agym_jax.furniture import BED
from agym_jax.human.body import RIGHT_ARM, RIGHT_ARM_LINKS
from agym_jax.observe import column, observation, part
from agym_jax.preferences import PREFERENCE_TERMS, preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Control, Ending, HumanSpec, Measure, Pose, Preferences, SeatSpec, ToolSpec
from agym_jax.tasks.shared.assisted_arm import ArmFromChest, ArmFromTorso, see_arm

_H = math.sqrt(0.5)
_RAD = math.pi / 180.0
RINGS, PER_RING = 11, 11
"""Largest numbers of rings on a limb and of points on a ring that fit on any person that can be drawn."""
PATCHES_ALONG, PATCHES_AROUND = 4, 6
"""Of each limb, along and around it: value functions see how much of each patch remains to be wiped."""
CLOSEST = 0.03
"""Smallest spacing of points for which these numbers suffice [m]."""


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [bed_bathing] unless noted otherwise.

    Attributes:
        distance: weight of the distance from wiper to person [1/m].
        action: weight of the squared action [1].
        wiping: reward for each point that is wiped [1].
        wiped: fraction of the points that must be wiped for success [1].
        spacing: distance between points on the skin, at least 0.03 [m].
        reach: distance from a contact of the pad within which points are wiped [m].
        preferences: weights of the human-preference terms.
    """

    distance: float = 1.0  # distance_weight
    action: float = 0.01  # action_weight
    wiping: float = 5.0  # wiping_reward_weight
    wiped: float = 0.3  # task_success_threshold
    spacing: float = CLOSEST  # AG bed_bathing.py generate_targets
    reach: float = 0.025  # AG bed_bathing.py get_total_force
    preferences: Preferences = Preferences()

    def __post_init__(self) -> None:
        """Reject a spacing with too many points.

        Raises:
            SpecError: if the points are closer together than ``CLOSEST``.
        """
        if self.spacing < CLOSEST:
            raise SpecError(
                f"BedBathing's spacing must be at least {CLOSEST} m, got {self.spacing}: a limb has room for "
                f"{RINGS} rings of {PER_RING} points."
            )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BathState:
    """The points of one episode and which have been wiped. Rows: upper arm, then forearm."""

    points_limb: Array  # in the limb's frame [m]                     (2, RINGS * PER_RING, 3)
    exists: Array  # whether this person has room for the point       (2, RINGS * PER_RING)
    dirty: Array  # 1 until wiped, 0 where none exists                (2, RINGS * PER_RING)
    points_w: Array  # in the world, now [m]                          (2, RINGS * PER_RING, 3)
    pad_force: Array  # of the pad on the person [N]                  ()


@observation(source="bed_bathing.py:66")
class RobotObs:
    """Observation of the robot."""

    tool_pos_torso: Array = column(3, "m", "world axes, from the robot's torso")
    tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    arm_angles: Array = column(7, "rad", "joints")
    assisted_arm: ArmFromTorso = part(ArmFromTorso)  # shoulder, elbow, wrist
    tool_force: Array = column(1, "N", "sum over all contacts of the tool")


@observation(source="bed_bathing.py:71")
class HumanObs:
    """Observation of the active person."""

    tool_pos_human: Array = column(3, "m", "world axes, from the chest")
    tool_quat_w: Array = column(4, "1 (wxyz)", "world")
    human_angles: Array = column(10, "rad", "right arm's joints")
    assisted_arm: ArmFromChest = part(ArmFromChest)  # shoulder, elbow, wrist
    force_on_human: Array = column(1, "N", "tool and robot on the person")
    tool_on_human: Array = column(1, "N", "tool on the person")


WIPER = ToolSpec(
    name="wiper",
    model="tools/wiper.xml",
    # AG: tool z against the approach (robots.md section 9, Jaco)
    grasp=Pose((0.0, 0.0, 0.03), (_H, 0.0, -_H, 0.0)),
    tip="tool_tip",
    geoms=tuple(
        f"wiper_{part}_{edge}_collision"
        for part in ("pad", "plate")
        for edge in ("back", "front", "right", "left")
    ),
    n_working=4,
    parts=(4, 4),
    outline="wiper_outline_collision",
)


@dataclass(frozen=True)
class BedBathing:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    name: str = "BedBathing"
    # AG env.py and bed_bathing.py: 0.02 s x 5, gain 0.05 a step, 1 N m, 5 x 0.05 rad
    control: Control = Control(
        time_step=0.02, frame_skip=5, rate=0.05 / 0.02, max_torque=1.0, action_scale=0.25
    )
    gravity: float = -1.0  # AG bed_bathing.py reset: on the person only
    arms: tuple[str, ...] = ("left",)
    goals: tuple[tuple[str, ...], ...] = (RIGHT_ARM_LINKS,)
    tool: ToolSpec = WIPER
    # AG bed_bathing.py reset; limb_rolling: deviation bed-contact
    seat: SeatSpec = replace(
        BED, friction=5.0, rolling=5.0, limb_rolling=0.15, outline=("pillow_side_outline", "pillow_slope_outline")
    )  # fmt: skip
    human: HumanSpec = HumanSpec(
        joints=RIGHT_ARM,
        pose={},
        postures="BedBathing",
        hold_rate=0.05 / 0.02,
        move_rate=0.05 / 0.02,  # AG: gain 0.05 for the active person
        max_torque=1.0,
        tremor_amplitude=10 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=("right_upper_arm", "right_forearm", "right_hand", "right_girdle",
               "chest", "waist", "hips", "head", "right_thigh"),
        passive_mode="welded",
    )  # fmt: skip
    episode_length: int = 200
    reward_terms: tuple[str, ...] = ("distance", "action", "wiping", *PREFERENCE_TERMS)
    measures: tuple[Measure, ...] = (
        Measure("wiped", "1", "share of the skin of upper arm and forearm that is wiped"),
    )
    endings: tuple[Ending, ...] = (
        Ending("less than 10 % wiped", "wiped", high=0.1),
        Ending("10 to 25 % wiped", "wiped", high=0.25),
        Ending("more than 25 % wiped", "wiped"),
    )
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, world [m] (1, 3). AG bed_bathing.py reset."""
        centre = jnp.array([[-0.6, 0.2, 1.0]])
        return centre + jax.random.uniform(key, (1, 3), minval=-0.05, maxval=0.05)

    def init(self, key: Array, sensed: Sensed) -> BathState:
        """Cover this person's arm with points. AG bed_bathing.py generate_targets."""
        d = sensed.dims
        limbs = [(d.upper_arm_l, d.upper_arm_r), (d.forearm_l, d.forearm_r)]
        points, exists = zip(*(self._cover(length, r) for length, r in limbs), strict=True)
        points, exists = jnp.stack(points), jnp.stack(exists)
        return BathState(points, exists, exists, _in_world(points, sensed), jnp.float32(0.0))

    def _cover(self, length: Array, radius: Array) -> tuple[Array, Array]:
        """Return rings of points around a limb (RINGS * PER_RING, 3), and which of them exist."""
        d = self.config.spacing
        n_rings = jnp.floor(length / d)
        n_around = jnp.floor(2 * jnp.pi * radius / d)
        ring, place = np.divmod(np.arange(RINGS * PER_RING), PER_RING)
        along = length * (ring + 1) / (n_rings + 1)
        angle = place * d / radius
        local = jnp.stack([-radius * jnp.sin(angle), -radius * jnp.cos(angle), -along], axis=-1)
        exists = jnp.asarray((ring < n_rings) & (place < n_around), jnp.float32)
        return local * exists[:, None], exists

    def advance(self, state: BathState, sensed: Sensed) -> tuple[BathState, dict[str, Array]]:
        """Move the points with the arm, and wipe those near a contact of the pad."""
        tool = sensed.tool
        points = _in_world(state.points_limb, sensed)
        force = tool.touch_force * tool.touch_working
        apart = jnp.linalg.norm(points[..., None, :] - tool.touch_pos_w, axis=-1)
        near = jnp.any((apart < self.config.reach) & (force > 0), axis=-1)
        wiped = state.dirty * near
        state = replace(state, dirty=state.dirty - wiped, points_w=points, pad_force=jnp.sum(force))
        return state, {"wiped": jnp.sum(wiped)}

    def rewards(
        self, state: BathState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG bed_bathing.py step."""
        c = self.config
        return {
            "distance": -c.distance * sensed.tool.gap,
            "action": -c.action * jnp.sum(jnp.square(action)),
            "wiping": c.wiping * events["wiped"],
            **preference_terms(
                c.preferences,
                jnp.linalg.norm(sensed.tool.vel_w),
                sensed.force_on_human,
                state.pad_force,
            ),
        }

    def observe(self, state: BathState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """Return the observations of robot and person."""
        s, tool, torso, chest = sensed, sensed.tool, sensed.torso_pos_w, sensed.human_pos_w
        arm_torso, arm_chest = see_arm(s)
        robot = RobotObs(
            tool_pos_torso=tool.pos_w - torso,
            tool_quat_w=tool.quat_w,
            arm_angles=s.arm_angles,
            assisted_arm=arm_torso,
            tool_force=tool.force,
        )
        human = HumanObs(
            tool_pos_human=tool.pos_w - chest,
            tool_quat_w=tool.quat_w,
            human_angles=s.human_angles,
            assisted_arm=arm_chest,
            force_on_human=s.force_on_human,
            tool_on_human=tool.on_human,
        )
        return robot, human

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        return 2 * PATCHES_ALONG * PATCHES_AROUND

    def privileged_obs(self, state: BathState) -> Array:
        """Return the fraction of each patch of upper arm and forearm that remains to be wiped (privileged_obs_size,)."""
        ring, place = np.divmod(np.arange(RINGS * PER_RING), PER_RING)
        rings, places = (jnp.max(state.exists * (n + 1), 1, keepdims=True) for n in (ring, place))
        row = jnp.floor(ring * PATCHES_ALONG / rings)
        column = jnp.floor(place * PATCHES_AROUND / places)
        patch = jax.nn.one_hot(row * PATCHES_AROUND + column, PATCHES_ALONG * PATCHES_AROUND)
        left = jnp.einsum("ln,lnp->lp", state.dirty, patch)
        return (left / jnp.maximum(jnp.einsum("ln,lnp->lp", state.exists, patch), 1.0)).ravel()

    def success(self, state: BathState) -> Array:
        """Whether 30 % of the points have been wiped ()."""
        total = jnp.sum(state.exists)
        return total - jnp.sum(state.dirty) >= self.config.wiped * total

    def measure(self, state: BathState) -> dict[str, Array]:
        """Return the fraction of the points that have been wiped; they are evenly spaced on the skin."""
        return {"wiped": 1.0 - jnp.sum(state.dirty) / jnp.maximum(jnp.sum(state.exists), 1.0)}

    def markers(self, state: BathState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return the points that are not wiped yet, to be drawn. AG: cyan spheres of 1 cm; drawn smaller here."""
        points = jnp.where(state.dirty[..., None] > 0, state.points_w, jnp.nan)
        return [(points.reshape(-1, 3), 0.006, (0.0, 1.0, 1.0, 1.0))]


def _in_world(points: Array, sensed: Sensed) -> Array:
    """Return the points of both limbs in world coordinates (2, n, 3)."""
    limbs = RIGHT_ARM_LINKS[:2]
    return jnp.stack([
        sensed.link_pos_w[x] + points[i] @ sensed.link_rot_w[x].T for i, x in enumerate(limbs)
    ])  # fmt: skip


BED_BATHING = BedBathing()
