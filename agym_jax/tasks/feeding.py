"""Feeding: bring a spoonful of food to the person's mouth.

Assistive Gym v0.1 ``feeding.py`` (reference tasks.md section 4). Eight pieces of food lie in the spoon. A piece within
2 cm of the mouth counts as eaten; one that falls below 0.5 m or touches the table or the bowl counts as spilled; one that
touches the person elsewhere is penalised once. The task succeeds when six pieces have been eaten.

DEVIATION(bowl-draw): the bowl's place and the spoon's start are drawn independently; in AG the spoon
starts 0.4 m above the bowl, wherever that stands.
DEVIATION(bowl-shape): food meets the bowl as a box of the same height and footprint area; what touches it
is spilled, and gone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import BOWL, TABLE, WHEELCHAIR_AT_TABLE
from agym_jax.math3d import child_pose
from agym_jax.matter.particles.checks import check
from agym_jax.matter.particles.containers import SPOON_ORIGIN_IN_AG
from agym_jax.matter.particles.fill import fill, load_fill
from agym_jax.matter.particles.solver import FOOD, Contact, Particles, ParticleSpec, advance
from agym_jax.matter.shapes import Boxes
from agym_jax.preferences import MEAL_TERMS, PREFERENCE_TERMS, meal_terms, preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Control, Goal, HumanSpec, Measure, Pose, Preferences, SeatSpec, ToolSpec
from agym_jax.tasks.shared import meals
from agym_jax.tasks.shared.meals import Outcome

_H = 0.5**0.5
ABOVE_BOWL = (0.0, -0.1, 0.425)
"""Start position of the hand relative to the bowl's place [m]. AG feeding.py reset: 0.4 above its middle."""
BOWL_SPREAD = (0.05, 0.05, 0.0)  # [m], AG feeding.py reset
START_SPREAD = 0.05  # [m], AG feeding.py reset
TABLE_TOP = ((0.0, 0.0, 0.7), (0.75, 0.5, 0.025))
"""Centre of the table top, relative to the table's place, and half sizes [m]. furniture.md section 4."""
BOWL_BOX = ((0.0, 0.0, 0.03), (0.064, 0.064, 0.03))
"""The same for the bowl, a cylinder of radius 0.072 and height 0.06 [m]. furniture.md section 5."""


@dataclass(frozen=True)
class Config:
    """Weights and thresholds. AG v0.1 config.ini [feeding] unless noted otherwise.

    Attributes:
        distance: weight of the distance from spoon to mouth [1/m].
        action: weight of the squared action [1].
        food: weight of the rewards and costs of pieces of food [1].
        eaten: reward for each piece that is eaten [1].
        spilled: cost of each piece that is spilled [1].
        mouth: distance from the mouth within which a piece is eaten [m].
        fallen: height below which a piece is spilled [m].
        share: fraction of the pieces that must be eaten for success [1].
        preferences: weights of the human-preference terms.
    """

    distance: float = 1.0  # distance_weight
    action: float = 0.01  # action_weight
    food: float = 1.0  # food_reward_weight
    eaten: float = 20.0  # AG feeding.py get_food_rewards
    spilled: float = 5.0  # the same
    mouth: float = 0.02  # the same
    fallen: float = 0.5  # the same
    share: float = 0.75  # task_success_threshold
    preferences: Preferences = Preferences()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FeedState:
    """The food of one episode and what has become of it."""

    food: Particles
    has_hit: Array  # pieces that have touched the person                       (n,) bool
    eaten: Array  # how many                                                    ()
    lost: Array  # pieces that went non-finite, int32                           ()
    bowl_pos_w: Array  # where the bowl stands [m]                              (3,)
    mouth_pos_w: Array  # now [m]                                               (3,)


SPOON = ToolSpec(
    name="spoon",
    model="tools/spoon.xml",
    # the handle lies across the hand, along its -x, the bowl opens along the hand's y
    grasp=Pose((0.1, -0.0225, 0.03), (_H, 0.0, -_H, 0.0)),
    tip="tool_tip",
    geoms=("spoon_middle_collision", "spoon_right_collision", "spoon_left_collision",
           "spoon_handle_collision"),
    n_working=3,
)  # fmt: skip
DISH = Pose(SPOON_ORIGIN_IN_AG, (_H, -_H, 0.0, 0.0))
"""Frame of ``matter.particles.containers.SPOON`` in the tool's frame."""


@dataclass(frozen=True)
class Feeding:
    """The task: data for the scene, and pure functions for the environment."""

    config: Config = Config()
    food: ParticleSpec = FOOD
    name: str = "Feeding"
    cpu_rows: ClassVar[tuple[int, int]] = (1, 32)  # see sim.c_mujoco.ROWS
    # AG env.py, feeding.py: 0.01 s x 10 of 5 solver sub-steps, gain 0.0005 each, 5 x 1 N m, 10 x 0.05 rad
    control: Control = Control(
        time_step=0.01, frame_skip=10, rate=0.0005 / 0.002, max_torque=5.0, action_scale=0.5
    )
    gravity: float = 0.0  # AG feeding.py reset: none on the person; the food has its own
    arms: tuple[str, ...] = ("right",)
    goals: tuple[tuple[Goal, ...], ...] = ((Goal("mouth", required=True), Goal("mouth", yaw=0.0)),)
    tool: ToolSpec = SPOON
    seat: SeatSpec = WHEELCHAIR_AT_TABLE
    human: HumanSpec = meals.diner(rate=0.0005 / 0.002, max_torque=5.0)
    episode_length: int = 200
    reward_terms: tuple[str, ...] = ("distance", "action", "food", *PREFERENCE_TERMS, *MEAL_TERMS)
    measures: tuple[Measure, ...] = (
        Measure("eaten", "1", "share of the food that is eaten"),
        Measure("spilled", "1", "share of the food that is spilled"),
    )
    endings: meals.Endings = meals.endings("eaten", "food left on the spoon")  # noqa: RUF009 (a tuple)
    robot_obs: type = meals.RobotObs
    human_obs: type = meals.HumanObs

    def __post_init__(self) -> None:
        """Reject settings that cannot be simulated accurately.

        Raises:
            MatterError: if there are more pieces than the vessel holds, or the steps are too long; the message gives the limit.
        """
        check(self.food, self.control.time_step, meals.THINNEST)

    def start(self, key: Array, robot: str) -> Array:
        """Return the start position of the hand, above the bowl, world [m] (1, 3). AG feeding.py reset."""
        key_bowl, key_hand = jax.random.split(key)
        noise = jax.random.uniform(key_hand, (1, 3), minval=-START_SPREAD, maxval=START_SPREAD)
        return _draw_bowl(key_bowl) + jnp.array(ABOVE_BOWL) + noise

    def init(self, key: Array, sensed: Sensed) -> FeedState:
        """Start with a full spoon, settled at this tilt, and a bowl somewhere near its place."""
        tool = sensed.tool
        dish = child_pose(tool.pos_w, tool.quat_w, DISH.pos, DISH.quat)
        return FeedState(
            food=fill(load_fill("spoon"), *dish),
            has_hit=jnp.zeros(self.food.count, bool),
            eaten=jnp.float32(0.0),
            lost=jnp.int32(0),
            bowl_pos_w=_draw_bowl(key),
            mouth_pos_w=sensed.mouth_pos_w,
        )

    def advance(self, state: FeedState, sensed: Sensed) -> tuple[FeedState, dict[str, Array]]:
        """Simulate the food as the spoon moves, and determine what has become of every piece."""
        mouth = sensed.mouth_pos_w
        around = meals.obstacles(sensed, DISH, _furniture(state.bowl_pos_w))
        food, contact = advance(self.food, state.food, around, self.control.time_step)
        outcome = outcome_of(self.config, food, contact, state.has_hit, mouth)
        count = lambda mask: jnp.sum(mask, dtype=jnp.float32)  # noqa: E731
        state = FeedState(
            food=food.remove(outcome.eaten | outcome.spilled),
            has_hit=state.has_hit | outcome.hit,
            eaten=state.eaten + count(outcome.eaten),
            lost=state.lost + contact.lost,
            bowl_pos_w=state.bowl_pos_w,
            mouth_pos_w=mouth,
        )
        return state, {
            "eaten": count(outcome.eaten), "spilled": count(outcome.spilled), "hits": count(outcome.hit),
            "speed": outcome.speed,
        }  # fmt: skip

    def rewards(
        self, state: FeedState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Return the weighted reward terms. AG feeding.py step."""
        c = self.config
        distance = jnp.linalg.norm(state.mouth_pos_w - sensed.tool.pos_w)
        return {
            "distance": -c.distance * distance,
            "action": -c.action * jnp.sum(jnp.square(action)),
            "food": c.food * (c.eaten * events["eaten"] - c.spilled * events["spilled"]),
            **preference_terms(
                c.preferences,
                jnp.linalg.norm(sensed.tool.vel_w),
                sensed.force_on_human,
                sensed.tool_on_human,  # the spoon's touch is wanted, within bounds
            ),
            **meal_terms(c.preferences, events["hits"], events["speed"]),
        }

    def observe(self, state: FeedState, sensed: Sensed) -> tuple[meals.RobotObs, meals.HumanObs]:
        """Return the observations of robot and person."""
        return meals.observe(sensed)

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        return meals.PRIVILEGED_OBS_SIZE

    def privileged_obs(self, state: FeedState) -> Array:
        """Return how much food is left and where it is (privileged_obs_size,)."""
        return meals.privileged_obs(state.food, state.eaten, state.mouth_pos_w)

    def success(self, state: FeedState) -> Array:
        """Whether three quarters of the food has been eaten ()."""
        return state.eaten >= self.config.share * self.food.count

    def measure(self, state: FeedState) -> dict[str, Array]:
        """Return the fractions of the pieces that have been eaten and spilled."""
        eaten, spilled = meals.delivered(state.food, state.eaten, state.lost)
        return {"eaten": eaten, "spilled": spilled}

    def markers(self, state: FeedState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Return the remaining food, and AG's green sphere at the mouth."""
        return [
            (meals.drawn(state.food.pos_w, state.food.alive), self.food.radius, (0.86, 0.42, 0.24, 1.0)),
            (state.mouth_pos_w, 0.01, (0.0, 1.0, 0.0, 1.0)),
        ]  # fmt: skip

    def props(self, state: FeedState) -> dict[str, Array]:
        """Return the position of the bowl, world [m] (3,)."""
        return {BOWL.name: state.bowl_pos_w}


def outcome_of(
    config: Config, food: Particles, contact: Contact, has_hit: Array, mouth_pos_w: Array
) -> Outcome:
    """Classify every piece, in AG's order: eaten, otherwise spilled, otherwise a first hit.

    Args:
        config: thresholds.
        food: food at the end of the control step.
        contact: contacts of the pieces in the last physics step of the control step.
        has_hit: pieces that have touched the person before (n,).
        mouth_pos_w: current position of the mouth [m] (3,).
    """
    away = jnp.linalg.norm(food.pos_w - mouth_pos_w, axis=-1)
    eaten = food.alive & (away < config.mouth)
    fallen = food.pos_w[:, 2] < config.fallen
    spilled = food.alive & ~eaten & (fallen | contact.furniture)
    hit = food.alive & ~eaten & ~spilled & contact.human & ~has_hit
    speed = jnp.sum(jnp.where(eaten, jnp.linalg.norm(food.vel_w, axis=-1), 0.0))
    return Outcome(eaten, spilled, hit, speed)


def _draw_bowl(key: Array) -> Array:
    """Draw the position of the bowl, world [m] (3,)."""
    spread = jnp.array(BOWL_SPREAD)
    return jnp.array(BOWL.pose.pos) + spread * jax.random.uniform(key, (3,), minval=-1.0)


def _furniture(bowl_pos_w: Array) -> Boxes:
    """Return the boxes of table and bowl."""
    (top, top_half), (bowl, bowl_half) = TABLE_TOP, BOWL_BOX
    return Boxes(
        pos_w=jnp.stack([jnp.array(TABLE.pose.pos) + jnp.array(top), bowl_pos_w + jnp.array(bowl)]),
        quat_w=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (2, 1)),
        half=jnp.array([top_half, bowl_half]),
    )


FEEDING = Feeding()
