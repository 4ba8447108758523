# ruff: noqa: D103
"""Feeding by hand: reference tasks.md section 4 and humans.md section 9, without MJX."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meal_scene import (
    AIR,
    CHEST,
    FLIGHT,
    FLIGHT_SPEED,
    HEAD,
    MOUTH,
    MOUTH_AHEAD,
    SKULL_TOP,
    STRAIGHT,
    TORSO,
    TURN,
    UPRIGHT,
    arrays,
    particles,
    sensed,
    touched,
)  # fmt: skip

from agym_jax import observe
from agym_jax.furniture import BOWL
from agym_jax.matter.particles.checks import MatterError
from agym_jax.robots import ROBOTS
from agym_jax.spec import Preferences
from agym_jax.tasks.feeding import FEEDING as TASK
from agym_jax.tasks.feeding import FeedState, outcome_of

advance = jax.jit(TASK.advance)
AWAY = np.array([0.0, -1.0, 0.0])  # from the mouth, over the table [m]
NOTHING = {"eaten": 0.0, "spilled": 0.0, "hits": 0.0, "speed": 0.0}


def judged(places, has_hit=False, speeds=0.0, alive=True, **touches):
    food = particles(places, speeds, alive)
    n = len(food.alive)
    hit = jnp.broadcast_to(jnp.asarray(has_hit), (n,))
    outcome = outcome_of(
        TASK.config, food, touched(n, **touches), hit, jnp.asarray(MOUTH, jnp.float32)
    )
    return jax.device_get(outcome)


def state(places=None, **changes) -> FeedState:
    """Eight pieces, far from everything unless said."""
    places = np.tile([-0.1, -0.5, 1.3], (8, 1)) if places is None else places
    food = particles(places)
    n = len(food.alive)
    values = {
        "food": food, "has_hit": jnp.zeros(n, bool), "eaten": jnp.float32(0),
        "lost": jnp.int32(0), "bowl_pos_w": arrays(np.array(BOWL.pose.pos)), "mouth_pos_w": arrays(MOUTH),
    }  # fmt: skip
    return FeedState(**values | changes)


@pytest.mark.parametrize(("away", "eaten"), [(0.0, True), (0.0199, True), (0.0201, False)])
def test_eaten_within_2_cm_of_the_mouth(away: float, eaten: bool):
    for axis in np.eye(3):
        outcome = judged([MOUTH + away * axis])
        assert (bool(outcome.eaten[0]), bool(outcome.spilled[0]), bool(outcome.hit[0])) == (
            eaten,
            0,
            0,
        )


@pytest.mark.parametrize(("z", "spilled"), [(0.501, False), (0.499, True), (-1.0, True)])
def test_spilled_below_half_a_metre(z: float, spilled: bool):
    assert bool(judged([[0.3, -0.2, z]]).spilled[0]) == spilled


def test_spilled_on_table_and_bowl():
    assert judged([MOUTH + AWAY], furniture=True).spilled[0]
    assert not judged([MOUTH + AWAY], vessel=True, floor=True).spilled[0]


def test_the_order_is_eaten_then_spilled_then_hit():
    low = np.array([0.3, -0.2, 0.4])
    places = [MOUTH, low, MOUTH + AWAY, MOUTH + AWAY, MOUTH + AWAY]
    outcome = judged(places, human=True, furniture=[True, False, True, False, False],
                   has_hit=[False, False, False, False, True])  # fmt: skip
    np.testing.assert_array_equal(outcome.eaten, [True, False, False, False, False])
    np.testing.assert_array_equal(outcome.spilled, [False, True, True, False, False])
    np.testing.assert_array_equal(outcome.hit, [False, False, False, True, False])


def test_what_is_gone_is_not_judged_again():
    outcome = judged([MOUTH, [0, 0, 0.1], MOUTH + AWAY], alive=False, human=True, furniture=True)
    assert (
        not (outcome.eaten.any() or outcome.spilled.any() or outcome.hit.any())
        and outcome.speed == 0
    )


def test_speed_is_that_of_the_eaten_pieces():
    outcome = judged([MOUTH, MOUTH, MOUTH + AWAY], speeds=[0.3, 0.5, 9.0])
    np.testing.assert_allclose(outcome.speed, 0.8, rtol=1e-6)


def test_a_piece_at_the_mouth_is_eaten_once_and_leaves():
    ahead = sensed(turn=STRAIGHT)
    offset, speed = FLIGHT
    start = state(np.vstack([MOUTH_AHEAD + offset, np.tile([-0.1, -0.5, 1.3], (7, 1))]))
    food = replace(start.food, alive=jnp.arange(8) == 0, vel_w=arrays(np.tile(speed, (8, 1))))
    after, events = advance(replace(start, food=food), ahead)
    assert (float(after.eaten), float(events["eaten"])) == (1.0, 1.0)
    np.testing.assert_allclose(events["speed"], FLIGHT_SPEED, rtol=0.02)
    assert not after.food.alive.any()
    again, events = advance(after, ahead)
    assert float(again.eaten) == 1.0 and float(events["eaten"]) == 0.0


def test_a_piece_that_falls_on_the_table_is_spilled_once_and_leaves():
    above = np.tile([0.2, -0.8, 0.735], (8, 1)) + np.arange(8)[:, None] * [0.03, 0, 0]
    after, events = advance(state(above), sensed())
    assert float(events["spilled"]) == 8 and not after.food.alive.any()
    _, events = advance(after, sensed())
    assert float(events["spilled"]) == 0


def test_a_piece_that_falls_into_the_bowl_is_spilled_wherever_the_bowl_stands():
    places = np.array([-0.15, -0.55, 0.80]) + np.arange(8)[:, None] * [0.2, 0, 0]
    bowl = arrays(np.array([0.05, -0.55, 0.725]))
    _, events = advance(state(places, bowl_pos_w=bowl), sensed())
    assert float(events["spilled"]) == 1  # only that over the bowl has come down on something


def test_a_piece_that_hits_the_person_counts_once_and_stays():
    above = np.tile(np.add(SKULL_TOP, [0, 0, 0.04]), (8, 1)) + np.arange(8)[:, None] * [0, 0, 0.02]
    food = replace(particles(above), alive=jnp.arange(8) < 1)
    now, hits = replace(state(above), food=food), []
    for _ in range(3):
        now, events = advance(now, sensed(turn=STRAIGHT))
        hits.append(float(events["hits"]))
    assert sum(hits) == 1.0 and now.has_hit[0] and now.food.alive[0]


def test_success_at_six_of_eight():
    assert not TASK.success(state(eaten=jnp.float32(5)))
    assert TASK.success(state(eaten=jnp.float32(6)))


def test_reward_is_assistive_gyms():
    """R = -|mouth - spoon| - 0.01 |a|^2 + (20 eaten - 5 spilled) + r_pref."""
    tool = {
        "pos_w": MOUTH + np.array([0.0, 0.3, 0.4]), "vel_w": np.array([0.0, 0.3, 0.4]),
        "on_human": 12.0,
    }  # fmt: skip
    seen = sensed(tool, pushes=3.0)
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    events = arrays({"eaten": 2.0, "spilled": 3.0, "hits": 2.0, "speed": 0.7})
    terms = TASK.rewards(state(), events, seen, action)
    expected = {
        "distance": -1.0 * 0.5,
        "action": -0.01 * 2.0,
        "food": 1.0 * (2 * 20 - 3 * 5),
        "preference_velocity": -0.25 * 0.5,  # config.ini human_preferences
        "preference_force_nontarget": -0.01 * 3.0,  # of the robot's body only
        "preference_high_forces": -0.05 * 12.0,
        "preference_food_hit": -1.0 * 2.0,
        "preference_food_velocities": -1.0 * 0.7,
    }
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_weights_are_assistive_gyms():
    # tasks.md section 9
    c, p = TASK.config, Preferences()
    assert (c.distance, c.action, c.food, c.share) == (1.0, 0.01, 1.0, 0.75)
    assert (c.eaten, c.spilled, c.mouth, c.fallen) == (20.0, 5.0, 0.02, 0.5)
    assert (p.food_hit, p.food_velocities) == (1.0, 1.0)
    # section 1.3, 1.5: 0.0123 rad in a control step of a full action, under 5 N m
    control = TASK.control
    free = control.action_scale * (1 - np.exp(-control.rate * control.period))
    np.testing.assert_allclose(free, 0.0123, atol=5e-5)
    assert np.isclose(control.period, 0.1) and control.max_torque == 5.0
    assert TASK.episode_length == 200 and TASK.gravity == 0.0 and TASK.food.gravity == -9.81
    assert TASK.human.passive_mode == "frozen" and len(TASK.human.joints) == 4
    assert set(TASK.human.impairments) == {"none", "limits", "weakness", "tremor"}
    assert np.allclose(list(TASK.human.pose_range.values()), np.deg2rad(30))


def test_observations_are_differences_along_world_axes():
    tool = {"pos_w": np.array([-0.1, -0.3, 1.1]), "quat_w": UPRIGHT, "on_human": 2.0}
    seen = sensed(tool, pushes=0.5)
    robot, human = TASK.observe(state(), seen)
    spoon = tool["pos_w"]
    for found, expected in (
        (robot.tool_pos_torso, spoon - TORSO), (robot.tool_quat_w, UPRIGHT),
        (robot.tool_pos_mouth, spoon - MOUTH), (robot.arm_angles, np.arange(7)),
        (robot.head_pos_torso, HEAD - TORSO), (robot.head_quat_w, TURN),
        (robot.tool_on_human, 2.0),
        (human.tool_pos_human, spoon - CHEST), (human.tool_quat_w, UPRIGHT),
        (human.tool_pos_mouth, spoon - MOUTH), (human.human_angles, np.arange(4)),
        (human.head_pos_human, HEAD - CHEST), (human.head_quat_w, TURN),
        (human.robot_on_human, 0.5), (human.tool_on_human, 2.0),
    ):  # fmt: skip
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # tasks.md section 4: 25 and 23 columns, in that order
    assert observe.size(TASK.robot_obs) == 25 and observe.size(TASK.human_obs) == 23
    order = ["tool_pos_torso", "tool_quat_w", "tool_pos_mouth", "arm_angles", "head_pos_torso",
             "head_quat_w", "tool_on_human"]  # fmt: skip
    assert list(observe.columns(TASK.robot_obs)) == order


def test_mouth_follows_the_head():
    head, turn = np.add(HEAD, [0.02, -0.03, 0.01]), np.array([0.8, 0.0, 0.6, 0.0])
    after, _ = advance(state(), sensed(head=head, turn=turn))
    seen = sensed(head=head, turn=turn)
    np.testing.assert_allclose(after.mouth_pos_w, seen.mouth_pos_w)
    assert np.linalg.norm(np.asarray(after.mouth_pos_w) - MOUTH) > 0.02


@pytest.mark.parametrize("tilt", [0.1, 0.2])  # robots.md section 9: how the hands hold it
def test_an_episode_begins_with_a_full_spoon(tilt: float):
    half = (np.pi / 2 + tilt) / 2
    tool = {"quat_w": np.array([np.cos(half), np.sin(half), 0.0, 0.0])}
    begun = TASK.init(jax.random.PRNGKey(0), sensed(tool))
    food = begun.food
    assert food.pos_w.shape == (8, 3) and food.alive.all() and float(begun.eaten) == 0
    # tasks.md section 7 of furniture.md: the pieces' middle is 13.5 mm above the spoon's origin
    turn = np.array(
        [[1, 0, 0], [0, -np.sin(tilt), -np.cos(tilt)], [0, np.cos(tilt), -np.sin(tilt)]]
    )
    local = (np.asarray(food.pos_w) - AIR["pos_w"]) @ turn
    np.testing.assert_allclose(local.mean(0), (0, 0.0135, -0.004), atol=0.005)
    still = begun
    for _ in range(20):  # two seconds
        still, events = advance(still, sensed(tool))
        assert {k: float(v) for k, v in events.items()} == NOTHING
    moved = np.linalg.norm(np.asarray(still.food.pos_w - food.pos_w), axis=-1)
    assert still.food.alive.all() and moved.max() < 0.004


def test_bowls_fill_the_references_box():
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    begun = jax.vmap(lambda k: TASK.init(k, sensed()).bowl_pos_w)(keys)
    share = (np.asarray(begun) - [-0.15, -0.55, 0.725])[:, :2] / 0.05
    assert (np.abs(share) <= 1 + 1e-5).all() and (np.ptp(share, axis=0) > 1.98).all()
    np.testing.assert_allclose(begun[:, 2], 0.725)
    assert TASK.props(state())[BOWL.name].shape == (3,)


@pytest.mark.parametrize("robot", ROBOTS)
def test_start_positions_fill_the_references_box(robot: str):
    # tasks.md section 4: bowl + (0, -0.1, 0.4) + U(-0.05, 0.05)^3, the bowl's x and y drawn too
    keys = jax.random.split(jax.random.PRNGKey(0), 4000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    assert p.shape == (4000, 1, 3)
    away = np.abs(p[:, 0] - [-0.15, -0.65, 1.15])
    assert (away <= [0.1 + 1e-5, 0.1 + 1e-5, 0.05 + 1e-5]).all()
    assert (away.max(0) > [0.09, 0.09, 0.0495]).all()
    assert (away.mean(0)[:2] < 0.04).all()  # two draws together: a triangle, not a box


def test_markers_are_the_food_that_is_there_and_the_mouth():
    now = state()
    now = replace(now, food=now.food.remove(jnp.arange(8) < 3))
    (food, radius, _), (mouth, _, green) = TASK.markers(now)
    assert np.isnan(food[:3]).all() and np.isfinite(food[3:]).all() and radius == 0.005
    np.testing.assert_allclose(mouth, MOUTH, atol=1e-6)
    assert green == (0.0, 1.0, 0.0, 1.0)


def test_more_food_than_the_spoon_holds_is_refused():
    with pytest.raises(MatterError, match=r"100 particles .* it holds \d+"):
        replace(TASK, food=replace(TASK.food, count=100))
    with pytest.raises(MatterError, match="could cross a wall"):
        replace(TASK, control=replace(TASK.control, time_step=0.1, frame_skip=1))


def test_a_piece_that_goes_wrong_is_counted_and_gone():
    places = np.tile([-0.1, -0.5, 1.3], (8, 1)) + np.arange(8)[:, None] * [0.02, 0, 0]
    places[3, 0] = np.nan
    after, events = advance(state(places), sensed())
    assert int(after.lost) == 1 and int(after.food.alive.sum()) == 7
    assert all(np.isfinite(x).all() for x in jax.tree.leaves((after, events)))
