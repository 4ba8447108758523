# ruff: noqa: D103
"""ArmManipulation by hand: reference tasks.md section 7 and humans.md section 9, without physics."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.human import anthropometry
from agym_jax.observe import values
from agym_jax.robots import ROBOTS
from agym_jax.sense import Sensed, ToolSensed
from agym_jax.tasks.arm_manipulation import ARM_MANIPULATION as TASK
from agym_jax.tasks.arm_manipulation import ArmState

ELBOW, HAND = np.array([-0.62, 0.2, 0.75]), np.array([-0.65, -0.05, 0.6])
LINKS = {
    "chest": np.array([-0.15, 0.2, 0.875]), "right_upper_arm": np.array([-0.32, 0.35, 0.85]),
    "right_forearm": ELBOW, "right_hand": HAND, "waist": np.array([-0.15, 0.05, 0.87]),
    "hips": np.array([-0.15, -0.05, 0.86]),
}  # fmt: skip
AIR = {
    "pos_w": np.array([-0.9, 0.7, 0.8]), "quat_w": np.array([1.0, 0, 0, 0]), "vel_w": np.zeros(3),
    "gap": 0.3, "touch_force": np.zeros(6), "touch_pos_w": np.zeros((6, 3)),
    "touch_working": np.ones(6), "on_human": 0.0, "force": 0.0,
}  # fmt: skip
REST = {
    "arm_angles": np.arange(14.0), "torso_pos_w": np.array([-1.2, 0.0, 1.0]),
    "human_angles": np.arange(10.0), "robot_on_human": 0.0,
}  # fmt: skip
LEFT = {
    "pos_w": ELBOW + np.array([0.0, 0.3, 0.4]),
    "vel_w": np.array([0.0, 0.3, 0.4]),
}  # 50 cm away
RIGHT = {
    "pos_w": HAND + np.array([0.0, 0.0, 0.2]), "vel_w": np.array([0.2, 0, 0]), "quat_w": np.array([0, 1.0, 0, 0])
}  # fmt: skip

TWO_PARTS = {"touch_force": np.array([4.0, 0, 2, 0, 0, 0]), "on_human": 6.0}
ONE_PART = {"touch_force": np.array([0.0, 0, 0, 0, 0, 5]), "on_human": 5.0}


def changed(nothing: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    assert set(changes) <= set(nothing), set(changes) - set(nothing)
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), nothing | changes)


def sensed(*tools: dict[str, Any], links: dict[str, Any] | None = None, **changes: Any) -> Sensed:
    """Somebody whose right arm hangs over the bed, and as many scoopers as are given."""
    return Sensed(
        tools=tuple(ToolSensed(**changed(AIR, t)) for t in tools),
        link_pos_w=changed(LINKS, links or {}),
        link_rot_w={k: jnp.eye(3) for k in LINKS},
        link_quat_w={k: jnp.array([1.0, 0, 0, 0]) for k in LINKS},
        motion=None,
        dims=anthropometry.dims(0.0),
        **changed(REST, changes),
    )


def nearness(links: dict[str, np.ndarray] = LINKS) -> float:
    """d_h of tasks.md section 7."""
    to_waist = np.linalg.norm(links["right_forearm"] - links["waist"])
    return -to_waist - np.linalg.norm(links["right_hand"] - links["hips"])


def lifted(elbow: float, hand: float) -> dict[str, np.ndarray]:
    """The arm on the body: elbow so far from the waist, hand so far from the hips."""
    return {
        "right_forearm": LINKS["waist"] - np.array([elbow, 0, 0]),
        "right_hand": LINKS["hips"] - np.array([hand, 0, 0]),
    }


def rewards(seen: Sensed, action: np.ndarray) -> dict[str, jax.Array]:
    state = TASK.init(jax.random.PRNGKey(0), seen)
    state, events = TASK.advance(state, seen)
    assert events == {}
    return TASK.rewards(state, events, seen, jnp.asarray(action))


def check(found: dict[str, Any], expected: dict[str, float]) -> None:
    assert set(found) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_reward_of_two_arms_is_assistive_gyms():
    """R = 0.5 d_h + 0.25 d_L + 0.25 d_R - 0.01 |a|^2 + r_pref."""
    seen = sensed(
        LEFT | TWO_PARTS,
        RIGHT | ONE_PART, robot_on_human=7.0,
    )  # fmt: skip
    check(
        rewards(seen, np.full(14, 0.5)),
        {
            "distance_human": 0.5 * nearness(),
            "distance_tools": -0.25 * 0.5 - 0.25 * 0.2,
            "action": -0.01 * 14 * 0.25,
            "preference_velocity": -0.25 * (0.5 + 0.2),  # of both
            # the robot's touch, but not the scoopers'
            "preference_force_nontarget": -0.01 * 7.0,
            "preference_high_forces": 0.0,
            # 6 N over two parts, 5 N over one (deviation pressure)
            "preference_high_pressures": -0.01 * (6.0 / 2 + 5.0 / 1),
        },
    )


def test_reward_of_one_arm_is_assistive_gyms():
    """R = 0.5 d_h + 0.5 d_L - 0.01 |a|^2 + r_pref: the one tool goes to the elbow."""
    seen = sensed(LEFT | TWO_PARTS, robot_on_human=7.0)
    check(
        rewards(seen, np.array([1.0, 0, 0, 0, 0, 0, -1.0])),
        {
            "distance_human": 0.5 * nearness(),
            "distance_tools": -0.5 * 0.5,
            "action": -0.02,
            "preference_velocity": -0.25 * 0.5,  # once (deviation one-arm)
            "preference_force_nontarget": -0.07,
            "preference_high_forces": 0.0,
            "preference_high_pressures": -0.03,
        },
    )


def test_tool_that_touches_nothing_presses_on_nothing():
    assert float(rewards(sensed(LEFT, RIGHT), np.zeros(14))["preference_high_pressures"]) == 0.0


def test_left_tool_belongs_to_the_elbow_and_right_to_the_hand():
    there = sensed({"pos_w": ELBOW}, {"pos_w": HAND})
    swapped = sensed({"pos_w": HAND}, {"pos_w": ELBOW})
    assert float(rewards(there, np.zeros(14))["distance_tools"]) == 0.0
    apart = np.linalg.norm(ELBOW - HAND)
    np.testing.assert_allclose(
        rewards(swapped, np.zeros(14))["distance_tools"], -0.5 * apart, rtol=1e-5
    )


def test_best_is_kept_and_counts_from_the_first_step():
    far, near, nearer = (
        sensed(LEFT, RIGHT, links=links) for links in ({}, lifted(0.5, 0.4), lifted(0.3, 0.3))
    )
    # AG sets its best at the first step, whatever the arm looked like before
    state = TASK.init(jax.random.PRNGKey(0), nearer)
    assert not TASK.success(state)
    best, now = [], []
    for seen in (far, near, nearer, far, near):
        state, _ = TASK.advance(state, seen)
        best.append(float(state.best))
        now.append(float(state.nearness))
    np.testing.assert_allclose(now, [nearness(), -0.9, -0.6, nearness(), -0.9], rtol=1e-6)
    np.testing.assert_allclose(best, [nearness(), -0.9, -0.6, -0.6, -0.6], rtol=1e-6)
    assert TASK.success(state)  # by what once was
    reward = TASK.rewards(state, {}, near, jnp.zeros(14))["distance_human"]
    np.testing.assert_allclose(reward, -0.45, rtol=1e-6)  # what is now is what pays


@pytest.mark.parametrize(("elbow", "hand", "done"), [
    (0.35, 0.3499, True), (0.35, 0.3501, False), (0.6999, 0.0, True), (0.0, 0.7001, False),
])  # fmt: skip
def test_success_within_70_cm_together(elbow: float, hand: float, done: bool):
    seen = sensed(LEFT, RIGHT, links=lifted(elbow, hand))
    state, _ = TASK.advance(TASK.init(jax.random.PRNGKey(0), seen), seen)
    assert bool(TASK.success(state)) == done


def test_unset_best_is_no_success():
    assert not TASK.success(ArmState(jnp.float32(0.0), jnp.float32(-jnp.inf)))


def observed(*tools: dict[str, Any], **changes: Any):
    seen = sensed(*tools, **changes)
    return TASK.observe(TASK.init(jax.random.PRNGKey(0), seen), seen)


def test_observations_of_two_arms():
    torso, chest = REST["torso_pos_w"], LINKS["chest"]
    robot, human = observed(
        LEFT | {"force": 3.0, "on_human": 2.0}, RIGHT | {"force": 4.0, "on_human": 1.0},
        robot_on_human=0.5,
    )  # fmt: skip
    expected = [
        (robot.left_tool_pos_torso, LEFT["pos_w"] - torso),
        (robot.left_tool_quat_w, AIR["quat_w"]),
        (robot.right_tool_pos_torso, RIGHT["pos_w"] - torso),
        (robot.right_tool_quat_w, RIGHT["quat_w"]),
        (robot.arm_angles, np.arange(14)),
        (robot.left_tool_force, 3.0), (robot.right_tool_force, 4.0),
        (human.left_tool_pos_human, LEFT["pos_w"] - chest),
        (human.left_tool_quat_w, AIR["quat_w"]),
        (human.right_tool_pos_human, RIGHT["pos_w"] - chest),
        (human.right_tool_quat_w, RIGHT["quat_w"]),
        (human.human_angles, np.arange(10)),
        (human.force_on_human, 3.5),
        (human.left_tool_on_human, 2.0), (human.right_tool_on_human, 1.0),
    ]  # fmt: skip
    names = {
        "shoulder": "right_upper_arm", "elbow": "right_forearm", "wrist": "right_hand",
        "waist": "waist", "hips": "hips",
    }  # fmt: skip
    for name, link in names.items():
        expected.append((values(robot)[f"{name}_pos_torso"], LINKS[link] - torso))
        expected.append((values(human)[f"{name}_pos_human"], LINKS[link] - chest))
    for found, value in expected:
        np.testing.assert_allclose(found, value, atol=1e-6)


def test_one_arm_stands_in_both_places():
    tool = LEFT | {"force": 3.0, "on_human": 2.0}
    robot, human = observed(tool, arm_angles=np.arange(7.0), robot_on_human=0.5)
    for what in ("pos_torso", "quat_w"):
        left, right = (getattr(robot, f"{side}_tool_{what}") for side in ("left", "right"))
        np.testing.assert_array_equal(left, right)
    # AG asks whether it is the right tool's first, then whether it is the left one's
    assert (float(robot.left_tool_force), float(robot.right_tool_force)) == (0.0, 3.0)
    assert (float(human.left_tool_on_human), float(human.right_tool_on_human)) == (0.0, 2.0)
    np.testing.assert_array_equal(robot.arm_angles, [*range(7), *range(7)])
    assert float(human.force_on_human) == 2.5  # its force counts once


@pytest.mark.parametrize("robot", ROBOTS)
def test_start_positions_fill_the_references_boxes(robot: str):
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    left = (-0.9, 0.4, 1.0) if robot == "Jaco" else (-0.9, 0.7, 0.8)
    share = (p - np.array([left, (-0.9, -0.3, 0.8)])) / 0.05
    assert p.shape == (2000, 2, 3) and (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()
    # the two are drawn on their own
    assert abs(np.corrcoef(share[:, 0, 0], share[:, 1, 0])[0, 1]) < 0.1


def test_arms_of_each_robot():
    sides = {name: TASK.arms for name in ("PR2", "Baxter")} | {
        "Jaco": ("left",),
        "Sawyer": ("left",),
    }
    for name, used in sides.items():
        robot = ROBOTS[name]
        assert robot.arms_for(TASK) == tuple(robot.arm(side) for side in used)


def test_facts_of_the_reference():
    # tasks.md sections 1.4, 1.5, 7; furniture.md section 3
    assert TASK.gravity == -9.81 and TASK.control.max_torque == 10.0  # deviation arm-torque
    assert TASK.seat.friction == 0.3 and TASK.seat.bears_upper_arm
    assert TASK.human.passive_mode == "limp" and "tremor" not in TASK.human.impairments
    assert TASK.human.moving(active=False) == TASK.human.joints  # it hangs, and can be lifted
    assert TASK.markers(TASK.init(jax.random.PRNGKey(0), sensed(LEFT, RIGHT))) == []
