# ruff: noqa: D103
"""ScratchItch by hand: reference tasks.md section 2 and humans.md section 9, without physics."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.kinematics import rotation_matrix
from agym_jax.preferences import preference_terms
from agym_jax.sense import Sensed
from agym_jax.spec import Preferences
from agym_jax.tasks.scratch_itch import SCRATCH_ITCH as TASK
from agym_jax.tasks.scratch_itch import ItchState

UPPER, FORE = (0.279, 0.043), (0.257, 0.033)  # length, radius of a man [m], humans.md section 3
SHOULDER, ELBOW = np.array([-0.179, 0.03, 1.0315]), np.array([-0.3185, 0.03, 0.7899])
TURN = rotation_matrix(np.array([0.8, 0.36, -0.48, 0.0]))


def sensed(**changes: Any) -> Sensed:
    """A man at rest with the tool in the air."""
    nothing: dict[str, Any] = {
        "tool_pos_w": np.array([-0.5, 0.0, 0.8]), "tool_quat_w": np.array([1.0, 0, 0, 0]),
        "tool_vel_w": np.zeros(3), "arm_angles": np.zeros(7), "torso_pos_w": np.array([-0.35, -0.3, 0.5]),
        "person_angles": np.zeros(10), "person_pos_w": np.array([0, 0.03, 0.89]),
        "shoulder_pos_w": SHOULDER, "elbow_pos_w": ELBOW, "wrist_pos_w": np.array([-0.3185, -0.26, 0.79]),
        "upper_arm_rot_w": np.eye(3), "forearm_rot_w": TURN,
        "upper_arm_length": UPPER[0], "upper_arm_radius": UPPER[1],
        "forearm_length": FORE[0], "forearm_radius": FORE[1],
        "touch_force": np.zeros(3), "touch_pos_w": np.zeros((3, 3)),
        "tool_on_person": 0.0, "robot_on_person": 0.0, "tool_force": 0.0,
    }  # fmt: skip
    unknown = set(changes) - set(nothing)
    assert not unknown, unknown
    return Sensed(**{k: jnp.asarray(v, jnp.float32) for k, v in (nothing | changes).items()})


def itch(target: Any = (0.0, -0.033, -0.1), on_forearm: float = 1.0, **changes: Any) -> ItchState:
    values = {
        "on_forearm": on_forearm, "target_limb": target, "target_pos_w": np.zeros(3),
        "last_scratch_w": np.zeros(3), "scratches": 0.0, "force_at_target": 0.0,
    } | changes  # fmt: skip
    return ItchState(**{k: jnp.asarray(v, jnp.float32) for k, v in values.items()})


TARGET_W = ELBOW + TURN @ [0.0, -0.033, -0.1]  # of ``itch()`` on ``sensed()``


def touching(force: float, offset: Any = (0.0, 0.0, 0.0), **changes: Any) -> Sensed:
    """The tool presses near the target, and nowhere else."""
    forces, places = np.zeros(3), np.zeros((3, 3))
    forces[1], places[1] = force, TARGET_W + np.asarray(offset)
    changes = {"tool_on_person": force, "tool_force": force} | changes
    return sensed(touch_force=forces, touch_pos_w=places, **changes)


def test_targets_lie_on_the_skin_of_either_limb():
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    s = jax.device_get(jax.vmap(lambda k: TASK.init(k, sensed()))(keys))
    assert abs(s.on_forearm.mean() - 0.5) < 0.045  # four standard deviations
    for fore, (length, radius) in ((0, UPPER), (1, FORE)):
        local = s.target_limb[s.on_forearm == fore]
        np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius, rtol=1e-5)
        along = -local[:, 2]
        # tasks.md: s ~ U(r, L), theta ~ U(0, 2 pi)
        assert radius <= along.min() < radius + 0.005 and length - 0.005 < along.max() <= length
        assert abs(along.mean() - (radius + length) / 2) < 0.01
        around = np.arctan2(local[:, 0], local[:, 1])
        assert np.abs(np.exp(1j * around).mean()) < 4 / np.sqrt(len(around))
    assert (s.scratches == 0).all() and (s.last_scratch_w == 0).all()


@pytest.mark.parametrize("fore", [0.0, 1.0])
def test_target_moves_with_its_limb_and_not_with_the_other(fore: float):
    start = itch(on_forearm=fore)
    turn, shift = rotation_matrix(np.array([0.6, 0.0, 0.8, 0.0])), np.array([0.1, -0.2, 0.3])
    mine, other = ("elbow", "shoulder") if fore else ("shoulder", "elbow")
    limb = "forearm" if fore else "upper_arm"
    old = ELBOW if fore else SHOULDER
    moved = sensed(**{f"{mine}_pos_w": old + shift, f"{limb}_rot_w": turn})
    state, _ = TASK.advance(start, moved)
    expected = old + shift + turn @ [0.0, -0.033, -0.1]
    np.testing.assert_allclose(state.target_pos_w, expected, atol=1e-6)
    before, _ = TASK.advance(start, sensed())
    aside, _ = TASK.advance(start, sensed(**{f"{other}_pos_w": np.zeros(3)}))
    np.testing.assert_array_equal(before.target_pos_w, aside.target_pos_w)


def test_target_of_init_is_where_advance_keeps_it():
    state = TASK.init(jax.random.PRNGKey(3), sensed())
    after, _ = TASK.advance(state, sensed())
    np.testing.assert_allclose(state.target_pos_w, after.target_pos_w, atol=1e-6)


@pytest.mark.parametrize(
    ("force", "offset", "counts"),
    [
        (4.0, (0, 0, 0), True),
        (4.0, (0.0245, 0, 0), True),  # 25 mm, scratch_itch.py get_total_force
        (4.0, (0.0255, 0, 0), False),
        (0.0, (0, 0, 0), False),
        (9.9, (0, 0, 0), True),  # 10 N, scratch_itch.py step
        (10.1, (0, 0, 0), False),
    ],
)
def test_what_counts_as_a_scratch(force: float, offset: tuple, counts: bool):
    state, events = TASK.advance(itch(), touching(force, offset))
    assert float(state.scratches) == counts
    np.testing.assert_allclose(events["scratch"], force if counts else 0.0, rtol=1e-6)
    inside = np.linalg.norm(offset) < 0.025
    np.testing.assert_allclose(state.force_at_target, force if inside else 0.0, rtol=1e-6)
    expected = TARGET_W + offset if counts else np.zeros(3)
    np.testing.assert_allclose(state.last_scratch_w, expected, atol=1e-6)


def test_stroke_is_measured_from_the_last_scratch_that_counted():
    # 10 mm, scratch_itch.py step: steps of 6 mm count every other time
    state, counts = itch(), []
    for i in range(5):
        state, events = TASK.advance(state, touching(2.0, (0.0, 0.0, 0.006 * (i - 2))))
        counts.append(float(events["scratch"]) > 0)
    assert counts == [True, False, True, False, True]
    assert float(state.scratches) == 3


def test_pressing_without_moving_counts_once():
    state = itch()
    for _ in range(10):
        state, _ = TASK.advance(state, touching(2.0))
    assert float(state.scratches) == 1


def test_forces_near_the_target_add_up_and_may_be_too_much_together():
    places = np.stack(
        [TARGET_W, TARGET_W + np.array([0, 0, 0.02]), TARGET_W + np.array([0, 0, 0.1])]
    )
    state, events = TASK.advance(itch(), sensed(touch_force=[3.0, 4.0, 50.0], touch_pos_w=places))
    np.testing.assert_allclose(state.force_at_target, 7.0, rtol=1e-6)
    np.testing.assert_allclose(events["scratch"], 7.0, rtol=1e-6)
    _, events = TASK.advance(itch(), sensed(touch_force=[6.0, 6.0, 0.0], touch_pos_w=places))
    assert float(events["scratch"]) == 0.0


def test_success_at_25_scratches():
    assert not TASK.success(itch(scratches=24.0))
    assert TASK.success(itch(scratches=25.0))
    state = itch(scratches=24.0)
    state, _ = TASK.advance(state, touching(2.0))
    assert TASK.success(state)


def test_reward_is_assistive_gyms():
    """R = -|target - tip| - 0.01 |a|^2 + 0.01 F_target + 2 r_scratch + r_pref."""
    tip = TARGET_W + np.array([0.03, 0.0, 0.04])  # 50 mm away
    seen = touching(
        6.0, tool_pos_w=tip, tool_vel_w=[0.0, 0.3, 0.4], tool_on_person=8.0, robot_on_person=5.0
    )
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    state, events = TASK.advance(itch(), seen)
    terms = TASK.rewards(state, events, seen, action)
    expected = {
        "distance": -1.0 * 0.05,
        "action": -0.01 * 2.0,
        "tool_force": 0.01 * 6.0,
        "scratch": 2.0 * 6.0,
        "preference_velocity": -0.25 * 0.5,  # config.ini human_preferences
        "preference_force_nontarget": -0.01 * (8.0 + 5.0 - 6.0),
        "preference_high_forces": 0.0,
    }
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(("force", "high"), [(9.9, 0.0), (10.0, -0.5), (30.0, -1.5)])
def test_preferences(force: float, high: float):
    # humans.md section 9: 0.05 x the force at the target from 10 N on
    terms = preference_terms(Preferences(), *(jnp.float32(x) for x in (0.2, force + 3.0, force)))
    np.testing.assert_allclose(terms["preference_velocity"], -0.05, rtol=1e-5)
    np.testing.assert_allclose(terms["preference_force_nontarget"], -0.03, rtol=1e-4)
    np.testing.assert_allclose(terms["preference_high_forces"], high, rtol=1e-5)


def test_observations_are_differences_along_world_axes():
    rng = np.random.default_rng(0)
    shift = np.array([0.3, -1.0, 2.0])
    points = {
        k: rng.normal(size=3)
        for k in (
            "tool_pos_w",
            "torso_pos_w",
            "person_pos_w",
            "shoulder_pos_w",
            "elbow_pos_w",
            "wrist_pos_w",
        )
    }
    s = sensed(**points, tool_force=3.0, tool_on_person=2.0, robot_on_person=0.5)
    state, _ = TASK.advance(itch(), s)
    robot, person = TASK.observe(dataclasses.replace(state, force_at_target=jnp.float32(1.5)), s)
    np.testing.assert_allclose(
        robot.tool_pos_torso, points["tool_pos_w"] - points["torso_pos_w"], atol=1e-6
    )
    np.testing.assert_allclose(
        robot.tool_pos_target, points["tool_pos_w"] - state.target_pos_w, atol=1e-6
    )
    np.testing.assert_allclose(
        robot.wrist_pos_torso, points["wrist_pos_w"] - points["torso_pos_w"], atol=1e-6
    )
    np.testing.assert_allclose(
        person.elbow_pos_person, points["elbow_pos_w"] - points["person_pos_w"], atol=1e-6
    )
    np.testing.assert_allclose(
        person.target_pos_person, state.target_pos_w - points["person_pos_w"], atol=1e-6
    )
    assert (
        float(robot.tool_force),
        float(person.force_on_person),
        float(person.force_at_target),
    ) == (3, 2.5, 1.5)
    # moving everything together changes nothing
    far = sensed(
        **{k: v + shift for k, v in points.items()},
        tool_force=3.0,
        tool_on_person=2.0,
        robot_on_person=0.5,
    )
    far_state, _ = TASK.advance(itch(), far)
    far_state = dataclasses.replace(far_state, force_at_target=jnp.float32(1.5))
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5),
        (robot, person),
        TASK.observe(far_state, far),
    )


def test_start_positions_fill_the_references_box():
    # tasks.md section 2: (-0.5, 0, 0.8) + U(-0.05, 0.05)^3
    p = np.asarray(jax.vmap(TASK.start)(jax.random.split(jax.random.PRNGKey(0), 2000)))
    share = (p - [-0.5, 0.0, 0.8]) / 0.05
    assert (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()


def test_marker_is_the_target():
    state, _ = TASK.advance(itch(), sensed())
    ((pos, radius, colour),) = TASK.markers(state)
    np.testing.assert_array_equal(pos, state.target_pos_w)
    assert radius == 0.01 and len(colour) == 4
