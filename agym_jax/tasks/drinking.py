"""Drinking: bring a cup of water to the person's mouth and pour.

Assistive Gym v0.1 ``drinking.py`` (reference tasks.md section 5). The cup holds 64 drops. A drop outside the cup counts as
drunk within 3 cm of the mouth, as spilled below a height of 0.5 m, and is penalised if it touches the person elsewhere.
The task succeeds when 48 drops have been drunk.

DEVIATION(cup-tilt): the tilt reward is AG's, -|roll of the cup's frame - that of a cup that lies before the
person|, but the difference of the two angles is taken on the circle. AG subtracts them as numbers: for an
upright cup, whose roll is pi or -pi, its reward jumps between -pi/2 and -3 pi/2. Both are equal but for a cup
tipped away from the person by less than a quarter turn, where AG's is less. Towards the person is told by the
cup at the beginning of the episode; AG has a sign for Jaco and one for the others.
DEVIATION(drinking-clock): ten physics steps of 10 ms, as in Feeding, in which the water takes 40 substeps of
2.5 ms; AG takes 25 steps of 4 ms. Motors follow the same exponential in time, and a control step is 0.1 s.
DEVIATION(cup-weight): the cup's 10 g and what is in it, 1 g a drop, weigh on the arm as in AG, where the motors' 1 N m are little
beside the 0.5 N m of a full cup at 0.7 m. The weight is that at the beginning of a control step, and without the
water's inertia: AG's is that of drops that push against the cup. Feeding's spoon and food, 18 g in AG where the motors reach 5 N m,
weigh nothing here.
DEVIATION(sip-speed): the speed of a drop is read before it vanishes; AG reads it afterwards, when it is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import WHEELCHAIR_UP_CLOSE
from agym_jax.math3d import child_pose, rotation_matrix
from agym_jax.matter.particles.checks import check
from agym_jax.matter.particles.fill import fill, load_fill
from agym_jax.matter.particles.solver import WATER, Contact, Particles, ParticleSpec, advance
from agym_jax.matter.shapes import no_boxes
from agym_jax.preferences import MEAL_TERMS, PREFERENCE_TERMS, meal_terms, preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Control, Goal, HumanSpec, Measure, Pose, Preferences, SeatSpec, ToolSpec
from agym_jax.tasks.shared import meals
from agym_jax.tasks.shared.meals import Outcome

_H = 0.5**0.5
CUP_MASS, DROP_MASS = 0.01, 0.001  # AG drinking.py, world_creation.py [kg]
GRAVITY = 9.81  # on the cup and the water [m/s^2], the same
BOTTOM, TOP, RADIUS = -0.01, 0.115, 0.05
"""Ends along the cup's axis, relative to its origin, and radius of the cylinder that counts as its inside [m]. AG drinking.py."""


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [drinking] unless noted otherwise.

    Attributes:
        distance: weight of the distance from the cup's rim to the mouth [1/m].
        action: weight of the squared action [1].
        tilt: weight of the cup's tilt [1/rad].
        water: weight of the rewards and costs of drops of water [1].
        drunk: reward for each drop that is drunk [1].
        spilled: cost of each drop that is spilled [1].
        mouth: distance from the mouth within which a drop is drunk [m].
        fallen: height below which a drop is spilled [m].
        share: fraction of the drops that must be drunk for success [1].
        preferences: weights of the human-preference terms.
    """

    distance: float = 1.0  # distance_weight
    action: float = 0.01  # action_weight
    tilt: float = 0.1  # cup_tilt_weight
    water: float = 1.0  # drinking_reward_weight
    drunk: float = 10.0  # AG drinking.py get_water_rewards
    spilled: float = 1.0  # the same
    mouth: float = 0.03  # the same
    fallen: float = 0.5  # the same
    share: float = 0.75  # task_success_threshold
    preferences: Preferences = Preferences()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DrinkState:
    """The water of one episode and what has become of it."""

    water: Particles
    drunk: Array  # how many drops                                              ()
    lost: Array  # drops that went non-finite, int32                            ()
    held: Array  # drops inside of the cup                                      ()
    centre_w: Array  # of the cup and those drops [m]                           (3,)
    side: Array  # 1 if the cup's z axis rises when it tips towards the person, -1 if it falls   ()
    mouth_pos_w: Array  # now [m]                                               (3,)


CUP = ToolSpec(
    name="cup",
    model="tools/cup.xml",
    # it stands along the hand's y, as in AG's PR2's
    grasp=Pose((0.0, -0.05, -0.01), (_H, 0.0, -_H, 0.0)),
    tip="tool_tip",
    geoms=(*(f"cup_rim_{i}_collision" for i in range(1, 7)), "cup_body_collision"),
    n_working=6,
)
INSIDE = Pose((0.0, 0.0, 0.0), (_H, -_H, 0.0, 0.0))
"""Frame of ``matter.particles.containers.CUP`` in the tool's frame."""


@dataclass(frozen=True)
class Drinking:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    water: ParticleSpec = WATER
    name: str = "Drinking"
    cpu_rows: ClassVar[tuple[int, int]] = (1, 16)  # see sim.c_mujoco.ROWS
    # AG env.py and drinking.py: 25 steps of 0.004 s, gain 0.0005 for each, 1 N m, 25 x 0.05 rad
    control: Control = Control(
        time_step=0.01, frame_skip=10, rate=0.0005 / 0.004, max_torque=1.0, action_scale=1.25
    )
    gravity: float = 0.0  # AG drinking.py reset: none on the person; the water has its own
    arms: tuple[str, ...] = ("right",)
    goals: tuple[tuple[Goal, ...], ...] = ((Goal("mouth", required=True), Goal("mouth", yaw=0.0)),)
    tool: ToolSpec = CUP
    seat: SeatSpec = WHEELCHAIR_UP_CLOSE
    human: HumanSpec = meals.diner(rate=0.0005 / 0.004, max_torque=1.0)
    episode_length: int = 200
    reward_terms: tuple[str, ...] = (
        "distance",
        "action",
        "tilt",
        "water",
        *PREFERENCE_TERMS,
        *MEAL_TERMS,
    )
    measures: tuple[Measure, ...] = (
        Measure("drunk", "1", "share of the water that is drunk"),
        Measure("spilled", "1", "share of the water that is spilled, on the person too"),
    )
    endings: meals.Endings = meals.endings("drunk", "water left in the cup")  # noqa: RUF009 (a tuple)
    robot_obs: type = meals.RobotObs
    human_obs: type = meals.HumanObs

    def __post_init__(self) -> None:
        """Reject settings that cannot be simulated accurately.

        Raises:
            MatterError: if there are more drops than the vessel holds, or the steps are too long; the message gives the limit.
        """
        check(self.water, self.control.time_step, meals.THINNEST)

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, world [m] (1, 3). AG drinking.py reset."""
        centre = jnp.array([[-0.2, -0.5, 1.0]])
        return centre + jax.random.uniform(key, (1, 3), minval=-0.05, maxval=0.05)

    def init(self, key: Array, sensed: Sensed) -> DrinkState:
        """Start with a cup of water that has settled at this tilt."""
        tool = sensed.tool
        inside = child_pose(tool.pos_w, tool.quat_w, INSIDE.pos, INSIDE.quat)
        water = fill(load_fill("cup"), *inside)
        held, centre = held_by(water, tool.pos_w, tool.quat_w)
        return DrinkState(
            water=water,
            drunk=jnp.float32(0.0),
            lost=jnp.int32(0),
            held=held,
            centre_w=centre,
            side=side_of(tool.quat_w, sensed.mouth_pos_w - tool.pos_w),
            mouth_pos_w=sensed.mouth_pos_w,
        )

    def advance(self, state: DrinkState, sensed: Sensed) -> tuple[DrinkState, dict[str, Array]]:
        """Simulate the water as the cup moves, and determine what has become of every drop."""
        mouth = sensed.mouth_pos_w
        around = meals.obstacles(sensed, INSIDE, no_boxes())
        water, contact = advance(self.water, state.water, around, self.control.time_step)
        outcome = outcome_of(
            self.config, water, contact, mouth, sensed.tool.pos_w, sensed.tool.quat_w
        )
        count = lambda mask: jnp.sum(mask, dtype=jnp.float32)  # noqa: E731
        water = water.remove(outcome.eaten | outcome.spilled | outcome.hit)
        held, centre = held_by(water, sensed.tool.pos_w, sensed.tool.quat_w)
        state = DrinkState(
            water=water,
            drunk=state.drunk + count(outcome.eaten),
            lost=state.lost + contact.lost,
            held=held,
            centre_w=centre,
            side=state.side,
            mouth_pos_w=mouth,
        )
        return state, {
            "drunk": count(outcome.eaten), "spilled": count(outcome.spilled), "hits": count(outcome.hit),
            "speed": outcome.speed,
        }  # fmt: skip

    def load(self, state: DrinkState) -> tuple[Array, Array]:
        """Return the weight of the cup and the water in it [N] (), and where it acts, world [m] (3,)."""
        return GRAVITY * (CUP_MASS + DROP_MASS * state.held), state.centre_w

    def rewards(
        self, state: DrinkState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG drinking.py step."""
        c, tool = self.config, sensed.tool
        top = tool.pos_w + TOP * axis(tool.quat_w)
        distance = jnp.linalg.norm(state.mouth_pos_w - top)
        return {
            "distance": -c.distance * distance,
            "action": -c.action * jnp.sum(jnp.square(action)),
            "tilt": c.tilt * tilt_reward(tool.quat_w, state.side),
            "water": c.water * (c.drunk * events["drunk"] - c.spilled * events["spilled"]),
            **preference_terms(
                c.preferences,
                jnp.linalg.norm(tool.vel_w),
                sensed.force_on_human,
                sensed.tool_on_human,  # the cup's touch is wanted, within bounds
            ),
            **meal_terms(c.preferences, events["hits"], events["speed"]),
        }

    def observe(self, state: DrinkState, sensed: Sensed) -> tuple[meals.RobotObs, meals.HumanObs]:
        """Return the observations of robot and person."""
        return meals.observe(sensed)

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        return meals.PRIVILEGED_OBS_SIZE

    def privileged_obs(self, state: DrinkState) -> Array:
        """Return how much water is left and where it is (privileged_obs_size,)."""
        return meals.privileged_obs(state.water, state.drunk, state.mouth_pos_w)

    def success(self, state: DrinkState) -> Array:
        """Whether three quarters of the water has been drunk ()."""
        return state.drunk >= self.config.share * self.water.count

    def measure(self, state: DrinkState) -> dict[str, Array]:
        """Return the fractions of the drops that have been drunk and spilled."""
        drunk, spilled = meals.delivered(state.water, state.drunk, state.lost)
        return {"drunk": drunk, "spilled": spilled}

    def markers(self, state: DrinkState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return the remaining water, and AG's green sphere at the mouth."""
        return [
            (meals.drawn(state.water.pos_w, state.water.alive), self.water.radius, (0.25, 0.5, 1.0, 1.0)),
            (state.mouth_pos_w, 0.01, (0.0, 1.0, 0.0, 1.0)),
        ]  # fmt: skip


def axis(cup_quat_w: Array) -> Array:
    """Return the direction of the cup's opening: its y axis in the world (3,)."""
    return rotation_matrix(cup_quat_w, normalize=True)[:, 1]


def side_of(cup_quat_w: Array, to_mouth_w: Array) -> Array:
    """Return whether an upright cup's z axis rises (1) or falls (-1) when it tips towards the person ().

    Args:
        cup_quat_w: orientation of the cup, wxyz (4,).
        to_mouth_w: vector from the cup to the mouth (3,).
    """
    return jnp.where(
        jnp.dot(rotation_matrix(cup_quat_w, normalize=True)[:, 2], to_mouth_w) > 0, -1.0, 1.0
    )


def tipped(cup_quat_w: Array, side: Array) -> Array:
    """Return how far the cup is tipped towards the person about its x axis, in (-pi, pi] [rad] ().

    Args:
        cup_quat_w: wxyz (4,).
        side: see ``side_of`` ().
    """
    _, up, across = rotation_matrix(cup_quat_w, normalize=True)[
        2
    ]  # how far each axis points upwards
    return jnp.arctan2(side * across, up)


def tilt_reward(cup_quat_w: Array, side: Array) -> Array:
    """Return minus the angle, at most pi, between the cup's tilt and that of a cup lying in front of the person [rad] ().

    Args:
        cup_quat_w: wxyz (4,).
        side: see ``side_of`` ().
    """
    missing = jnp.abs(tipped(cup_quat_w, side) - jnp.pi / 2)
    return -jnp.minimum(missing, 2 * jnp.pi - missing)


def in_cup(points_w: Array, cup_pos_w: Array, cup_quat_w: Array) -> Array:
    """Return which points (n, 3) count as inside the cup: AG's cylinder (n,)."""
    up, away = axis(cup_quat_w), points_w - cup_pos_w
    height = away @ up
    radius = jnp.linalg.norm(away - height[:, None] * up, axis=-1)
    return (height >= BOTTOM) & (height <= TOP) & (radius <= RADIUS)


def held_by(water: Particles, cup_pos_w: Array, cup_quat_w: Array) -> tuple[Array, Array]:
    """Return the number of drops inside the cup (), and the centre of mass of the cup and these drops, world [m] (3,).

    Args:
        water: current state of the water.
        cup_pos_w: position of the cup [m] (3,).
        cup_quat_w: orientation of the cup, wxyz (4,).
    """
    inside = (water.alive & in_cup(water.pos_w, cup_pos_w, cup_quat_w)).astype(jnp.float32)
    held = jnp.sum(inside)
    middle = cup_pos_w + 0.5 * (BOTTOM + TOP) * axis(cup_quat_w)
    moment = CUP_MASS * middle + DROP_MASS * inside @ jnp.where(
        inside[:, None] > 0, water.pos_w, 0.0
    )
    return held, moment / (CUP_MASS + DROP_MASS * held)


def outcome_of(
    config: Config, water: Particles, contact: Contact, mouth_pos_w: Array, cup_pos_w: Array,
    cup_quat_w: Array,
) -> Outcome:  # fmt: skip
    """Classify every drop outside the cup, in AG's order: drunk, otherwise spilled, otherwise a hit.

    Args:
        config: thresholds.
        water: water at the end of the control step.
        contact: contacts of the drops in the last physics step of the control step.
        mouth_pos_w: current position of the mouth [m] (3,).
        cup_pos_w: current position of the cup [m] (3,).
        cup_quat_w: current orientation of the cup, wxyz (4,).
    """
    out = water.alive & ~in_cup(water.pos_w, cup_pos_w, cup_quat_w)
    drunk = out & (jnp.linalg.norm(water.pos_w - mouth_pos_w, axis=-1) < config.mouth)
    spilled = out & ~drunk & (water.pos_w[:, 2] < config.fallen)
    hit = out & ~drunk & ~spilled & contact.human
    speed = jnp.sum(jnp.where(drunk, jnp.linalg.norm(water.vel_w, axis=-1), 0.0))
    return Outcome(drunk, spilled, hit, speed)


DRINKING = Drinking()
