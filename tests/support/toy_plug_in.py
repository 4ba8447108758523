"""What a newcomer writes: a robot and a task of their own, outside of agym_jax. Importing it adds both.

``test_plug_in.py`` imports it, and so does every command that is given ``toy_plug_in:WavingToybot-v0`` for an
id. As a program it builds the banks of its own ids: ``python tests/support/toy_plug_in.py build WavingToybot-v0``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.furniture import WHEELCHAIR
from agym_jax.human.body import HEAD
from agym_jax.observe import column, observation
from agym_jax.preferences import PREFERENCE_TERMS, preference_terms
from agym_jax.registry import register_robot, register_task
from agym_jax.sense import Sensed
from agym_jax.spec import Arm, Control, Goal, HumanSpec, Preferences, RobotSpec, SeatSpec

# -- the robot ---------------------------------------------------------------------------------

_ARM = Arm(
    joints=("turn_1", "bend_1", "turn_2", "bend_2", "turn_3", "bend_3", "turn_4"),
    end_effector="hand",
    tool_frame="hand",
    gripper=(),
    links=("hand_collision", "forearm_collision"),
)

TOYBOT = RobotSpec(
    name="Toybot",
    model=str(Path(__file__).parent / "data" / "toy_robot.xml"),  # an absolute path: not an asset
    arms={"left": _ARM, "right": _ARM},
    torso="torso",
    gripper_opening={},
)

# -- the task ----------------------------------------------------------------------------------

_RAD = math.pi / 180.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WaveState:
    """Where the hand should be, and how far it is from there."""

    goal_w: Array  # [m]                                                       (3,)
    distance: Array  # [m]                                                     ()


@observation
class RobotObs:
    """What the robot sees."""

    hand_pos_goal: Array = column(3, "m", "world axes, from the goal")
    arm_angles: Array = column(7, "rad", "joints")


@observation
class HumanObs:
    """What the active person sees and feels."""

    hand_pos_human: Array = column(3, "m", "world axes, from the chest")
    human_angles: Array = column(4, "rad", "neck and head joints")
    force_on_human: Array = column(1, "N", "robot on the person")


@dataclass(frozen=True)
class Waving:
    """Bring the hand above the person's head."""

    above: float = 0.4  # of the goal over the joint of the head [m]
    reached: float = 0.05  # [m]
    name: str = "Waving"
    control: Control = Control(
        time_step=0.02, frame_skip=5, rate=2.5, max_torque=1.0, action_scale=0.25
    )
    gravity: float = 0.0
    arms: tuple[str, ...] = ("right",)
    goals: tuple[tuple[Goal, ...], ...] = ((Goal("head", above=0.1),),)
    tool: None = None
    seat: SeatSpec = WHEELCHAIR
    human: HumanSpec = HumanSpec(
        joints=HEAD,
        pose={"r_hip_x": -90 * _RAD, "r_knee_x": 80 * _RAD, "l_hip_x": -90 * _RAD, "l_knee_x": 80 * _RAD},
        hold_rate=2.5,
        move_rate=2.5,
        max_torque=1.0,
        tremor_amplitude=20 * _RAD,
        impairments=("none", "limits", "weakness", "tremor"),
        limbs=("head", "neck", "chest"),
        passive_mode="welded",
    )  # fmt: skip
    episode_length: int = 100
    reward_terms: tuple[str, ...] = ("distance", *PREFERENCE_TERMS)
    robot_obs: type = RobotObs
    human_obs: type = HumanObs

    def start(self, key: Array, robot: str) -> Array:
        """Where the hand starts, world [m] (1, 3)."""
        return jnp.array([[-0.4, -0.4, 1.1]]) + jax.random.uniform(key, (1, 3), maxval=0.1)

    def init(self, key: Array, sensed: Sensed) -> WaveState:
        """The goal of the episode."""
        return self._look(sensed)

    def advance(self, state: WaveState, sensed: Sensed) -> tuple[WaveState, dict[str, Array]]:
        """Look where hand and head are now."""
        return self._look(sensed), {}

    def rewards(
        self, state: WaveState, events: dict[str, Array], sensed: Sensed, action: Array
    ) -> dict[str, Array]:
        """Weighted terms."""
        speed = jnp.linalg.norm(sensed.tool.vel_w)
        force = sensed.force_on_human
        terms = preference_terms(Preferences(), speed, force, jnp.float32(0.0))
        return {"distance": -state.distance, **terms}

    def observe(self, state: WaveState, sensed: Sensed) -> tuple[RobotObs, HumanObs]:
        """What robot and person see."""
        hand = sensed.tool.pos_w
        return (
            RobotObs(hand - state.goal_w, sensed.arm_angles),
            HumanObs(hand - sensed.human_pos_w, sensed.human_angles, sensed.force_on_human),
        )

    def success(self, state: WaveState) -> Array:
        """Whether the hand is above the head now ()."""
        return state.distance <= self.reached

    def markers(self, state: WaveState) -> list[tuple[Array, float, tuple[float, ...]]]:
        """Points to draw: a blue ball above the head."""
        return [(state.goal_w, 0.02, (0.2, 0.4, 1.0, 1.0))]

    def _look(self, sensed: Sensed) -> WaveState:
        goal = sensed.link_pos_w["head"] + jnp.array([0.0, 0.0, self.above])
        return WaveState(goal, jnp.linalg.norm(sensed.tool.pos_w - goal))


WAVING = Waving()

register_robot(TOYBOT)
register_task(WAVING)

if __name__ == "__main__":
    from agym_jax.offline.placements import main

    raise SystemExit(main())
