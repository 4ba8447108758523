"""Dressing: pull the sleeve of a hospital gown up the person's left arm.

Assistive Gym v0.1 ``dressing.py`` (reference tasks.md section 6). The person holds the left arm out to the side, with the
forearm pointing forwards. The gripper holds the gown at the neck, 0.33 m from the cuff, above the hand, and is rewarded
for how far up the arm the cuff has moved; success is 0.4 m, measured from the tip of the hand along forearm and upper arm.

DEVIATION(cloth-force): AG's number of the gown's force is 10 times the position corrections of one solver iteration,
summed over contacts below 1.1 m and 20 units, with robot and wheelchair among them. Observed and rewarded is what the
gown presses on the person, the mean over a control step, summed over its vertices [N], times AG_FORCE (with
``tapered_arms``, AG_FORCE_TAPERED).
DEVIATION(cloth-obstacles): the gown meets limbs, torso, the left armrest and the floor; the robot's arm, on which AG's gown rests if it is Jaco's (it touches the hands of all four), only in the share ``meets_robot``
of the episodes. With ``settled_gown``, Jaco's cuff is 10.5 cm off its place in AG from 1.1 to 3.5 s, with ``meets_robot`` besides 7.3, PR2's 7.1 and 6.7; as episodes begin, 5 and 7 (docs/parity.md). The gown stays 38 mm away from limbs, which are capsules. AG's
keeps 40 mm from limbs, and from spheres at shoulder, elbow and wrist, whose distance it knows at points 0.25 m apart, linear in between: in the middle of a man's forearm it stays 54 to 73 mm
from the axis (71 here), 51 to 83 mm from the middle of elbow and hand (81), and 34 to 47 mm 4 cm from the elbow (71); nearest in two recorded episodes, pressed: man 51, 43 and 25, woman 45, 40 and 12.
With ``tapered_arms``, the arm is found by the same grid here, in a share of the episodes (``agym_jax.matter.cloth.grid``).
DEVIATION(gown-on-human): the force on the person in the metrics, infos and evaluations is the robot's alone; AG's info adds the gown's, in its number.
DEVIATION(dressing-limits): the joint limits of the person's arm hold here as in every task.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.errors import SpecError
from agym_jax.furniture import WHEELCHAIR
from agym_jax.human.body import LEFT_ARM
from agym_jax.matter.cloth import sleeve
from agym_jax.matter.cloth import solver as fabrics
from agym_jax.matter.cloth.garment import GOWN, Garment, load
from agym_jax.matter.cloth.hang import hanging
from agym_jax.matter.cloth.obstacles import ag_grid, obstacles, on_limbs
from agym_jax.matter.cloth.robot_links import LinkGrids, Links, link_grids
from agym_jax.matter.cloth.solver import Cloth, ClothContact
from agym_jax.matter.cloth.starts import Starts, gown_at_start, load_starts
from agym_jax.matter.cloth.topology import GOWN_FABRIC, ClothSpec, Fabric, build_cloth
from agym_jax.matter.shapes import Capsules
from agym_jax.observe import column, observation, part
from agym_jax.preferences import DRESSING_TERMS, dressing_terms
from agym_jax.sense import Motion, Sensed
from agym_jax.spec import Control, Ending, Goal, HumanSpec, Measure, Preferences, SeatSpec, Surface
from agym_jax.tasks.shared.assisted_arm import ArmFromChest, ArmFromTorso

_RAD = math.pi / 180.0
UP = np.array([0.0, 0.0, 1.0], np.float32)
ARM_LINKS = ("left_upper_arm", "left_forearm", "left_hand")
"""Their origins are the shoulder, the elbow and the wrist."""
TOUCHABLE = (*ARM_LINKS, "left_girdle", "chest", "waist", "head", "left_thigh")
"""Limbs that the hand and the gown may touch."""
BELOW = ("neck", "right_thigh")
"""Further limbs on which the gown may lie."""
FLOOR = 0.0  # its height, world [m]
START = (0.45, -0.3, 1.2)  # of the hand, world [m]: AG dressing.py reset
START_SPREAD = 0.05  # [m], AG dressing.py reset
BELOW_HAND = 0.012
"""Distance from the end effector down to the middle of the held patch [m] (AG, recorded: 11 to 12 mm)."""
AG_FORCE = 2.3
"""Value of AG's measure of the gown's force that corresponds to one newton: benchmarks/parity/gown.py."""
AG_FORCE_TAPERED = 5.3
"""The same for arms as AG's cloth finds them, on which the gown presses less on the same paths."""
LEFT_BESIDE = replace(
    WHEELCHAIR,
    name="wheelchair_left",  # what carries a robot stands on the person's left
    geoms=("armrest_left_inner_collision", "armrest_left_outer_collision"),
    front=((1.25, -1.75, 1.75), (0.25, -0.1, 0.85)),
)


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [dressing] unless noted otherwise.

    Attributes:
        dressing: weight of how far the sleeve has moved up the arm [1/m].
        action: weight of the squared action [1].
        dressed: how far it must have moved for success [m].
        tapered_arms: share of the episodes in which the gown meets the arm as AG's cloth does, by distances that are linear
            between points 0.25 m apart: limbs taper, and have edges [1].
        meets_robot: share of the episodes in which the gown meets the robot's arm, as AG's cloth finds it [1].
        settled_gown: share of the episodes that begin with the packaged gown as it hung in AG, settled in front of the hand;
            in the others it swings back to the hand [1].
        preferences: weights of the human-preference terms.
    """

    dressing: float = 1.0  # dressing_reward_weight
    action: float = 0.01  # action_weight
    dressed: float = 0.4  # task_success_threshold
    tapered_arms: float = 0.0  # AG: 1
    meets_robot: float = 0.0  # AG: 1
    settled_gown: float = 0.0  # AG: 1
    preferences: Preferences = Preferences()

    def __post_init__(self) -> None:
        """Reject what is not a share.

        Raises:
            SpecError: if ``tapered_arms``, ``meets_robot`` or ``settled_gown`` is not between 0 and 1.
        """
        for name in ("tapered_arms", "meets_robot", "settled_gown"):
            if not 0.0 <= (share := getattr(self, name)) <= 1.0:
                raise SpecError(
                    f"Dressing's {name} is a share of the episodes, between 0 and 1; got {share}."
                )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DressState:
    """The gown of one episode and its progress up the arm."""

    cloth: Cloth
    slid: Array  # how far it has slid through the fingers, world [m]           (3,)
    on_arm: sleeve.SleeveState  # what the sleeve is on or was on just now
    dressed: Array  # AG's r_dress, now [m]                                     ()
    best: Array  # the best of it so far [m]                                    ()
    progress: Array  # share of the whole arm that is in the sleeve now         ()
    force: Array  # of the gown on each limb, mean of the last control step [N] (n_limbs,)
    tapered: Array  # whether the arm is as AG's cloth finds it, 0 or 1     ()
    meets: Array  # whether the gown meets the robot's arm, 0 or 1          ()


@observation(source="dressing.py _get_obs")
class RobotObs:
    """Observation of the robot."""

    hand_pos_torso: Array = column(3, "m", "world axes, from the robot's torso")
    hand_quat_w: Array = column(4, "1 (wxyz)", "world")
    arm_angles: Array = column(7, "rad", "joints")
    assisted_arm: ArmFromTorso = part(ArmFromTorso)  # shoulder, elbow, wrist
    cloth_force: Array = column(1, "AG's", "gown on the person, about 0.4 N each")


@observation(source="dressing.py _get_obs")
class HumanObs:
    """Observation of the active person."""

    hand_pos_human: Array = column(3, "m", "world axes, from the chest")
    hand_quat_w: Array = column(4, "1 (wxyz)", "world")
    human_angles: Array = column(10, "rad", "left arm's joints")
    assisted_arm: ArmFromChest = part(ArmFromChest)  # shoulder, elbow, wrist
    cloth_force: Array = column(1, "AG's", "gown on the person, about 0.4 N each")
    robot_on_human: Array = column(1, "N", "robot on the person")


@dataclass(frozen=True)
class Dressing:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    garment: str = GOWN
    fabric: Fabric = GOWN_FABRIC
    name: str = "Dressing"
    cpu_rows: ClassVar[tuple[int, int]] = (1, 2)  # see sim.c_mujoco.ROWS
    # AG env.py, dressing.py: 0.01 s x 10 of 4 solver sub-steps, gain 0.001 each, 4 x 1 N m, 10 x 0.05 rad
    control: Control = Control(
        time_step=0.01, frame_skip=10, rate=0.001 / 0.0025, max_torque=4.0, action_scale=0.5
    )
    gravity: float = -1.0  # AG dressing.py reset: on the person; the gown has its own
    arms: tuple[str, ...] = ("left",)
    # AG dressing.py reset: the hand along the upper arm at the shoulder, as it starts at elbow and wrist
    goals: tuple[tuple[Goal, ...], ...] = (
        tuple(Goal(x, 0.1, yaw) for x, yaw in zip(ARM_LINKS, (math.pi / 2, 0.0, 0.0), strict=True)),
    )
    tool: None = None
    seat: SeatSpec = LEFT_BESIDE
    human: HumanSpec = HumanSpec(
        joints=LEFT_ARM,
        # AG dressing.py reset: joints_positions
        pose={
            "r_elbow_x": -90 * _RAD, "l_shoulder_y": -80 * _RAD, "l_elbow_x": -90 * _RAD,
            "r_hip_x": -90 * _RAD, "r_knee_x": 80 * _RAD,
            "l_hip_x": -90 * _RAD, "l_knee_x": 80 * _RAD,
        },
        hold_rate=0.0025 / 0.0025,
        move_rate=0.0025 / 0.0025,  # AG: gain 0.0025 for tremor and the active person
        max_torque=4.0,  # AG: 4 x 1 N m
        tremor_amplitude=10 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=TOUCHABLE,
        links=BELOW,
        arm="left",
        passive_mode="frozen",
    )  # fmt: skip
    episode_length: int = 200
    reward_terms: tuple[str, ...] = ("dressing", "action", *DRESSING_TERMS)
    measures: tuple[Measure, ...] = (
        Measure("covered", "1", "share of the arm's length that is in the sleeve"),
        Measure("held", "1", "share of episodes in which the gripper still holds the gown"),
    )
    endings: tuple[Ending, ...] = (
        Ending("gown dropped", "held", high=0.5),
        Ending("hand not in the sleeve", "covered", high=0.01),
        Ending("hand in the sleeve", "covered"),
    )
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def prepare(self) -> None:
        """Load the garment and build its tables, when a scene is built rather than when the task is imported.

        Raises:
            GarmentError: if it cannot be worn or simulated; the message names the faulty edge, triangle or loop.
            MissingAssetError: if there is no such file.
            SpecError: if ``settled_gown`` is asked of another gown than the packaged one.
        """
        _ = self.spec, self.watched, self.starts

    @cached_property
    def gown(self) -> Garment:
        """The garment that is put on, in its hanging shape."""
        return hanging(load(self.garment), self.fabric)

    @cached_property
    def spec(self) -> ClothSpec:
        """The garment as the cloth solver represents it."""
        return build_cloth(self.gown, self.fabric)

    @cached_property
    def watched(self) -> np.ndarray:
        """Vertex indices of the two triangles that span the cuff (2, 3)."""
        return sleeve.watched_vertices(self.gown)

    @cached_property
    def starts(self) -> Starts | None:
        """How the packaged gown hung in AG when episodes began; None if no episode begins so. Refuses another garment."""
        if self.config.settled_gown <= 0.0:
            return None
        if self.garment != GOWN:
            raise SpecError(
                f"Dressing's settled_gown is for the packaged gown, {GOWN}; got {self.config.settled_gown} with {self.garment}."
            )
        return load_starts(self.spec.count)

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, world [m] (1, 3)."""
        noise = jax.random.uniform(key, (1, 3), minval=-START_SPREAD, maxval=START_SPREAD)
        return jnp.array([START]) + noise

    def init(self, key: Array, sensed: Sensed) -> DressState:
        """Start with the gown hanging from the gripper, at rest, in front of the person's hand."""
        nowhere, zero, c = jnp.bool_(False), jnp.float32(0.0), self.config
        tapered, settled, meets = (
            jax.random.bernoulli(jax.random.fold_in(key, i), share)
            for i, share in ((1, c.tapered_arms), (2, c.settled_gown), (3, c.meets_robot))
        )
        self._grids(sensed.motion)  # refuses a robot of which nothing is known
        hand_w = arm_of(sensed).hand_end_w
        state = DressState(
            cloth=gown_at_start(
                self.spec, self.starts, settled, key, sensed.tool.pos_w, BELOW_HAND, hand_w
            ),
            slid=jnp.zeros(3),
            on_arm=sleeve.SleeveState(nowhere, nowhere),
            dressed=zero,
            best=jnp.float32(-jnp.inf),
            progress=zero,
            force=jnp.zeros(len(TOUCHABLE) + len(BELOW)),
            tapered=jnp.float32(tapered),
            meets=jnp.float32(meets),
        )
        return self._judge(state, sensed)

    def advance(self, state: DressState, sensed: Sensed) -> tuple[DressState, dict[str, Array]]:
        """Simulate the gown as the hand moves, and measure how far up the arm it is."""
        state, touch = self._move(state, sensed)
        force = on_limbs(touch.total.mean(0), (*TOUCHABLE, *BELOW), self.config.tapered_arms > 0.0)
        # a gown that blew up is put back; NaN is what the environment's guard ends episodes for
        force = jnp.where(touch.broken.any(), jnp.nan, force)
        return self._judge(replace(state, force=force), sensed), {}

    def _move(self, state: DressState, sensed: Sensed) -> tuple[DressState, ClothContact]:
        """Return the gown after the n physics steps of a control step, and its contacts in each of them."""
        motion, tapers = sensed.motion, self.config.tapered_arms > 0.0
        limbs = (*TOUCHABLE, *BELOW)
        robot, grids = motion.robot, self._grids(motion)
        frames = grids.frames(robot.pos_w, robot.rot_w) if robot and grids else None
        a, b, radius = obstacles(sensed.dims, limbs, motion.link_pos_w, motion.link_rot_w, tapers)

        def one(carry: tuple, moment: tuple) -> tuple[tuple, ClothContact]:
            cloth, slid = carry
            (a0, b0, hand0, _, f0), (a1, b1, hand1, turned, f1) = moment
            links = None if grids is None else Links(f0, f1, state.meets, grids)
            grid = ag_grid(limbs, turned, state.tapered) if tapers else None
            cloth, touch = fabrics.step(
                self.spec, cloth, Capsules(a0, b0, radius), Capsules(a1, b1, radius),
                held_at(self.spec, hand0 + slid), held_at(self.spec, hand1 + slid),
                self.control.time_step, fabrics.in_hand(slid), FLOOR, grid, links,
            )  # fmt: skip
            return (cloth, fabrics.slip(slid, touch, self.control.time_step)), touch

        way = a, b, motion.tool_pos_w, {x: motion.link_rot_w[x] for x in ARM_LINKS}, frames
        moments = tuple(
            jax.tree.map(lambda x, part=part: x[part], way) for part in (slice(-1), slice(1, None))
        )
        (cloth, slid), touch = jax.lax.scan(one, (state.cloth, state.slid), moments)
        return replace(state, cloth=cloth, slid=slid), touch

    def _grids(self, motion: Motion) -> LinkGrids | None:
        """Return the shapes of the robot that the gown meets; None if it meets none in any episode."""
        robot = motion.robot
        return link_grids(robot.robot, robot.names) if robot and self.config.meets_robot else None

    def _judge(self, state: DressState, sensed: Sensed) -> DressState:
        """Measure how far up the arm the cuff is."""
        points, arm = state.cloth.pos_w[self.watched], arm_of(sensed)
        on_arm = sleeve.sleeve_state(points, arm).after(state.on_arm)
        dressed = sleeve.dressing_distance(points, arm, on_arm)
        best, progress = jnp.maximum(state.best, dressed), sleeve.progress(points, arm)
        return replace(state, on_arm=on_arm, dressed=dressed, best=best, progress=progress)

    def rewards(
        self, state: DressState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG dressing.py step."""
        c = self.config
        return {
            "dressing": c.dressing * state.dressed,
            "action": -c.action * jnp.sum(jnp.square(action)),
            **dressing_terms(c.preferences, jnp.linalg.norm(sensed.tool.vel_w), felt(state)),
        }

    def observe(self, state: DressState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """Return the observations of robot and person: not the gown itself, but its force on the arm."""
        s, hand, force = sensed, sensed.tool, felt(state)
        joints = [s.link_pos_w[link] for link in ARM_LINKS]
        robot = RobotObs(
            hand_pos_torso=hand.pos_w - s.torso_pos_w,
            hand_quat_w=hand.quat_w,
            arm_angles=s.arm_angles,
            assisted_arm=ArmFromTorso(*(joint - s.torso_pos_w for joint in joints)),
            cloth_force=force,
        )
        human = HumanObs(
            hand_pos_human=hand.pos_w - s.human_pos_w,
            hand_quat_w=hand.quat_w,
            human_angles=s.human_angles,
            assisted_arm=ArmFromChest(*(joint - s.human_pos_w for joint in joints)),
            cloth_force=force,
            robot_on_human=s.robot_on_human,
        )
        return robot, human

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        return 10

    def privileged_obs(self, state: DressState) -> Array:
        """Return which part of the arm the sleeve is on, how far, and the cuff relative to the grip (privileged_obs_size,)."""
        on, pos = state.on_arm, state.cloth.pos_w
        flags = [on.forearm, on.upper_arm, on.steps_off / sleeve.MEMORY_STEPS, state.dressed]
        off = pos[self.watched].mean((0, 1)) - pos[self.spec.garment.anchors].mean(0)
        return jnp.concatenate(
            [jnp.stack([jnp.asarray(x, jnp.float32) for x in flags]), off, state.slid]
        )

    def success(self, state: DressState) -> Array:
        """Whether the sleeve has been far enough up the arm at any time ()."""
        return state.best >= self.config.dressed

    def measure(self, state: DressState) -> dict[str, Array]:
        """Return how far up the arm the cuff is now: 0 at the tip of the hand, 1 at the shoulder; and 1 while the gown is in the gripper."""
        held = fabrics.in_hand(state.slid).astype(jnp.float32)
        return {"covered": state.progress, "held": held}

    def markers(self, state: DressState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return no markers: the gown is drawn as a surface."""
        return []

    def surfaces(self, state: DressState) -> list[Surface]:
        """Return the gown's surface."""
        return [Surface(state.cloth.pos_w, self.gown.triangles, (0.55, 0.76, 0.86, 1.0))]


def felt(state: DressState) -> Array:
    """Return the force of the gown on the person in AG's measure ()."""
    per_newton = AG_FORCE + state.tapered * (AG_FORCE_TAPERED - AG_FORCE)
    return per_newton * jnp.sum(state.force)


def held_at(spec: ClothSpec, hand_w: Array) -> Array:
    """Return the positions of the held vertices, world [m] (a, 3), from that of the gripper (3,): the patch keeps its orientation, as in AG."""
    return fabrics.anchor_positions(spec, hand_w - BELOW_HAND * UP)


def arm_of(sensed: Sensed) -> sleeve.SleeveArm:
    """Return the arm being dressed. Its hand, elbow and shoulder are as thick as the upper arm, as in AG."""
    shoulder, elbow, wrist = (sensed.link_pos_w[link] for link in ARM_LINKS)
    return sleeve.SleeveArm(shoulder, elbow, wrist, sensed.dims.upper_arm_r)


DRESSING = Dressing()
