# ruff: noqa: D103
"""Reaching by hand: reference tasks.md section 8 and humans.md section 9, without physics."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.human import anthropometry
from agym_jax.math3d import rotation_matrix
from agym_jax.robots import ROBOTS
from agym_jax.sense import Sensed, ToolSensed
from agym_jax.sim.scene import build_scene
from agym_jax.tasks.reaching import REACHING as TASK

HEAD, CHEST, TORSO = (
    np.array([0.0, 0.03, 1.1785]),
    np.array([0, 0.03, 0.89]),
    np.array([-1.0, 0, 1]),
)
TURN = np.array([0.9, 0.1, -0.3, 0.3])  # of the head, wxyz
MOUTH = {0.0: np.array([0, -0.11, 0.03]), 1.0: np.array([0, -0.10, 0.03])}  # in the head, section 4
HAND = {
    "pos_w": np.array([-0.15, -0.4, 1.0]), "quat_w": np.array([0.5, 0.5, 0.5, 0.5]),
    "vel_w": np.zeros(3), "gap": 0.3, "touch_force": np.zeros(0), "touch_pos_w": np.zeros((0, 3)),
    "touch_working": np.zeros(0), "on_human": 0.0, "force": 0.0,
}  # fmt: skip


def sensed(
    hand: dict[str, Any] | None = None, turn: np.ndarray = TURN, head: np.ndarray = HEAD,
    sex: float = 0.0, pushes: float = 0.0,
) -> Sensed:  # fmt: skip
    """Somebody who looks aside, and a bare hand."""
    assert set(hand or {}) <= set(HAND)
    turn = turn / np.linalg.norm(turn)
    arrays = lambda tree: jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), tree)  # noqa: E731
    return Sensed(
        tools=(ToolSensed(**arrays(HAND | (hand or {}))),),
        link_pos_w=arrays({"head": head, "chest": CHEST}),
        link_rot_w=arrays({"head": rotation_matrix(turn, np), "chest": np.eye(3)}),
        link_quat_w=arrays({"head": turn, "chest": np.array([1.0, 0, 0, 0])}),
        motion=None,
        dims=arrays(anthropometry.dims(sex)),
        **arrays({
            "arm_angles": np.arange(7.0), "torso_pos_w": TORSO, "human_angles": np.arange(4.0),
            "robot_on_human": pushes,
        }),
    )  # fmt: skip


def mouth(sex: float = 0.0, turn: np.ndarray = TURN, head: np.ndarray = HEAD) -> np.ndarray:
    return head + rotation_matrix(turn / np.linalg.norm(turn), np) @ MOUTH[sex]


@pytest.mark.parametrize("sex", MOUTH)
def test_goal_is_the_mouth_and_follows_the_head(sex: float):
    state = TASK.init(jax.random.PRNGKey(0), sensed(sex=sex))
    np.testing.assert_allclose(state.mouth_pos_w, mouth(sex), atol=1e-6)
    np.testing.assert_allclose(
        state.distance, np.linalg.norm(HAND["pos_w"] - mouth(sex)), rtol=1e-6
    )
    head, turn = HEAD + np.array([0.1, -0.2, 0.05]), np.array([0.8, 0.0, 0.6, 0.0])
    state, events = TASK.advance(state, sensed(turn=turn, head=head, sex=sex))
    np.testing.assert_allclose(state.mouth_pos_w, mouth(sex, turn, head), atol=1e-6)
    assert events == {}


@pytest.mark.parametrize(("away", "reached"), [
    (0.0, True), (0.0299, True), (0.0301, False), (0.3, False)
])  # fmt: skip
def test_success_within_3_cm(away: float, reached: bool):
    # deviation reaching-success: the tutorial's code always succeeds
    for axis in np.eye(3):
        state, _ = TASK.advance(
            TASK.init(jax.random.PRNGKey(0), sensed()), sensed({"pos_w": mouth() + away * axis})
        )
        assert bool(TASK.success(state)) == reached


def test_success_is_of_now():
    at, off = sensed({"pos_w": mouth()}), sensed()
    state, _ = TASK.advance(TASK.init(jax.random.PRNGKey(0), off), at)
    assert TASK.success(state)
    state, _ = TASK.advance(state, off)
    assert not TASK.success(state)


def test_reward_is_the_tutorials():
    """R = -|hand - mouth| + r_pref, and no price on the action."""
    hand = {"pos_w": mouth() + np.array([0.0, 0.3, 0.4]), "vel_w": np.array([0.0, 0.6, 0.8])}
    seen = sensed(hand, pushes=7.0)
    state, events = TASK.advance(TASK.init(jax.random.PRNGKey(0), seen), seen)
    expected = {
        "distance": -0.5,
        "preference_velocity": -0.25,
        "preference_force_nontarget": -0.07,
        "preference_high_forces": 0.0,
    }
    for action in (np.zeros(7), np.ones(7)):
        terms = TASK.rewards(state, events, seen, jnp.asarray(action))
        assert set(terms) == set(expected)
        for name, value in expected.items():
            np.testing.assert_allclose(terms[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_observations_are_differences_along_world_axes():
    seen = sensed(pushes=2.5)
    robot, human = TASK.observe(TASK.init(jax.random.PRNGKey(0), seen), seen)
    hand = HAND["pos_w"]
    for found, expected in (
        (robot.hand_pos_torso, hand - TORSO),
        (robot.hand_pos_mouth, hand - mouth()),
        (robot.arm_angles, np.arange(7)),
        (robot.hand_quat_w, HAND["quat_w"]),
        (robot.head_quat_w, TURN),
        (human.hand_pos_human, hand - CHEST),
        (human.hand_pos_mouth, hand - mouth()),
        (human.human_angles, np.arange(4)),
        (human.hand_quat_w, HAND["quat_w"]),
        (human.head_quat_w, TURN),
        (human.force_on_human, 2.5),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_start_positions_fill_the_references_box(robot: str):
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    share = (p - np.array([[-0.15, -0.4, 1.0]])) / 0.05
    assert p.shape == (2000, 1, 3) and (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()


def test_marker_is_green_and_at_the_mouth():
    ((place, radius, colour),) = TASK.markers(TASK.init(jax.random.PRNGKey(0), sensed()))
    np.testing.assert_allclose(place, mouth(), atol=1e-6)
    assert radius == 0.01 and colour == (0.0, 1.0, 0.0, 1.0)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_bare_hand_takes_the_tools_place(robot):
    # deviation reaching-speed: the hand that reaches, on the right where there is one
    scene = build_scene(TASK, robot)
    (hand,), (arm,) = scene.index.tools, scene.arms
    assert arm is robot.arm("right")
    assert scene.model.site(hand.tip).name == f"robot/{arm.end_effector}"
    assert [scene.model.joint(j).name for j in hand.joints] == [f"robot/{j}" for j in arm.joints]
    assert [scene.model.geom(g).name for g in hand.geoms] == [f"robot/{arm.links[0]}"]
    assert len(hand.on_human) == len(hand.on_seat) == 0 < len(scene.index.robot_human)


def test_facts_of_the_reference():
    # tasks.md sections 1.4, 8: no gravity on the person; head as Feeding, frozen unless active
    assert (
        TASK.gravity == 0.0
        and TASK.tool is None
        and {goal.link for goal in TASK.goals[0]} == {"mouth"}
    )
    assert TASK.human.passive_mode == "frozen" and len(TASK.human.joints) == 4
