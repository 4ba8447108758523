# ruff: noqa: D103
"""Drinking by hand: reference tasks.md section 5 and humans.md section 9, without MJX."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from meal_scene import (
    AIR,
    FLIGHT,
    FLIGHT_SPEED,
    HEAD,
    MOUTH,
    MOUTH_AHEAD,
    STRAIGHT,
    UPRIGHT,
    arrays,
    particles,
    sensed,
    touched,
)  # fmt: skip

from agym_jax import observe
from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.checks import MatterError
from agym_jax.robots import ROBOTS
from agym_jax.sim.control import Controller
from agym_jax.sim.scene import build_scene
from agym_jax.tasks.drinking import DRINKING as TASK
from agym_jax.tasks.drinking import DrinkState, axis, held_by, in_cup, outcome_of, tilt_reward

advance = jax.jit(TASK.advance)
CUP_AT = AIR["pos_w"]  # upright unless said
HELD = {"quat_w": UPRIGHT}
NOTHING = {"drunk": 0.0, "spilled": 0.0, "hits": 0.0, "speed": 0.0}


def turned(angle: float, about: tuple[float, float, float]) -> np.ndarray:
    """Orientation wxyz of a cup that was upright and then turned about an environment axis."""
    half, (w, x, y, z) = angle / 2, UPRIGHT
    b = np.array(about) / np.linalg.norm(about) * np.sin(half)
    a, v = np.cos(half), np.array([x, y, z])
    return np.array([a * w - b @ v, *(a * v + w * b + np.cross(b, v))])


def judged(places, speeds=0.0, alive=True, mouth=MOUTH, cup=CUP_AT, quat=UPRIGHT, **touches):
    water = particles(places, speeds, alive)
    contact = touched(len(water.alive), **touches)
    return jax.device_get(outcome_of(TASK.config, water, contact, *arrays((mouth, cup, quat))))


def state(places=None, **changes) -> DrinkState:
    """Drops at places, the rest of the 64 gone; all of them in the air unless said."""
    many = np.tile([0.3, -0.6, 1.5], (64, 1)) + np.arange(64)[:, None] * [0.02, 0, 0]
    there = np.ones(64, bool)
    if places is not None:
        many[: len(places)], there = places, np.arange(64) < len(places)
    water = replace(particles(many), alive=jnp.asarray(there))
    values = {
        "water": water, "drunk": jnp.float32(0), "lost": jnp.int32(0), "side": jnp.float32(1),
        "mouth_pos_w": arrays(MOUTH), "held": jnp.float32(0), "centre_w": arrays(CUP_AT),
    }  # fmt: skip
    return DrinkState(**values | changes)


def seen(tool=None, **changes):
    return sensed(HELD | (tool or {}), n_steps=TASK.control.frame_skip, **changes)


@pytest.mark.parametrize(
    ("height", "radius", "inside"),
    [  # tasks.md section 5: between -0.01 and 0.115 along the axis, within 0.05 of it
        (0.05, 0.0, True), (0.114, 0.049, True), (0.116, 0.0, False), (-0.009, 0.0, True),
        (-0.011, 0.0, False), (0.05, 0.051, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("tilt", [0.0, 1.3])
def test_inside_is_assistive_gyms_cylinder(height, radius, inside, tilt: float):
    quat = turned(tilt, (0.3, 0.9, 0.0))
    turn = rotation_matrix(quat, np)
    point = CUP_AT + turn @ [radius * 0.6, height, radius * 0.8]
    assert bool(in_cup(*arrays((point[None], CUP_AT, quat)))[0]) == inside


@pytest.mark.parametrize(("away", "drunk"), [(0.0, True), (0.0299, True), (0.0301, False)])
def test_drunk_within_3_cm_of_the_mouth(away: float, drunk: bool):
    for side in np.eye(3):
        outcome = judged([MOUTH + away * side])
        assert (bool(outcome.eaten[0]), bool(outcome.spilled[0]), bool(outcome.hit[0])) == (
            drunk,
            0,
            0,
        )


def test_water_in_the_cup_is_not_judged():
    # the mouth dips into the cup, which is low and touches the person
    low = np.array([0.0, 0.0, 0.3])
    outcome = judged(
        [np.add(low, [0, 0, 0.05])], mouth=np.add(low, [0, 0, 0.05]), cup=low, human=True
    )
    assert not (outcome.eaten[0] or outcome.spilled[0] or outcome.hit[0])
    outcome = judged(
        [np.add(low, [0, 0, 0.12])], mouth=np.add(low, [0, 0, 0.10]), cup=low, human=True
    )
    assert outcome.eaten[0]  # over the rim it is outside


@pytest.mark.parametrize(("z", "spilled"), [(0.501, False), (0.499, True), (-1.0, True)])
def test_spilled_below_half_a_metre(z: float, spilled: bool):
    assert bool(judged([[0.3, -0.2, z]]).spilled[0]) == spilled


def test_the_order_is_drunk_then_spilled_then_hit():
    places = [MOUTH, [0.3, -0.2, 0.4], [0.3, -0.2, 0.8], np.add(CUP_AT, [0, 0, 0.05])]
    outcome = judged(places, human=True)
    np.testing.assert_array_equal(outcome.eaten, [True, False, False, False])
    np.testing.assert_array_equal(outcome.spilled, [False, True, False, False])
    np.testing.assert_array_equal(outcome.hit, [False, False, True, False])
    assert not judged(places[2:3]).hit[0] and not judged(places[2:3], vessel=True).hit[0]


def test_what_is_gone_is_not_judged_again():
    outcome = judged([MOUTH, [0, 0, 0.1], [0.3, 0, 0.9]], alive=False, human=True)
    assert (
        not (outcome.eaten.any() or outcome.spilled.any() or outcome.hit.any())
        and outcome.speed == 0
    )


def test_a_drop_is_drunk_once_with_the_speed_it_came_with():
    offset, speed = FLIGHT  # deviation sip-speed
    start, ahead = state([MOUTH_AHEAD + offset]), seen(turn=STRAIGHT)
    water = replace(start.water, vel_w=arrays(np.tile(speed, (64, 1))))
    after, events = advance(replace(start, water=water), ahead)
    assert (float(after.drunk), float(events["drunk"])) == (1.0, 1.0)
    np.testing.assert_allclose(events["speed"], FLIGHT_SPEED, rtol=0.02)
    assert not after.water.alive.any()
    again, events = advance(after, ahead)
    assert float(again.drunk) == 1.0 and {k: float(v) for k, v in events.items()} == NOTHING


def test_a_drop_that_hits_the_person_counts_once_and_leaves():
    start = state([np.add(HEAD, [0.0, 0.0, 0.24])])
    hits = []
    for _ in range(3):
        start, events = advance(start, seen())
        hits.append(float(events["hits"]))
    assert sum(hits) == 1.0 and not start.water.alive.any()


def test_a_drop_that_falls_is_spilled_once_and_leaves():
    start = state([[0.3, -0.6, 0.52]])
    start, events = advance(start, seen())
    assert float(events["spilled"]) == 1.0 and not start.water.alive.any()
    _, events = advance(start, seen())
    assert float(events["spilled"]) == 0.0


def test_success_at_48_of_64():
    assert not TASK.success(state(drunk=jnp.float32(47)))
    assert TASK.success(state(drunk=jnp.float32(48)))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("tipped", "reward"),
    [(0.0, -np.pi / 2), (0.5, 0.5 - np.pi / 2), (np.pi / 2, 0.0), (3.0, np.pi / 2 - 3.0), (-0.5, -0.5 - np.pi / 2),
     (-np.pi / 2, -np.pi), (-3.0, 3.0 - 3 * np.pi / 2)],
)  # fmt: skip
def test_tipping_towards_the_person_is_rewarded(side: float, tipped: float, reward: float):
    quat = jnp.asarray(turned(-side * tipped, (1.0, 0.0, 0.0)), jnp.float32)
    np.testing.assert_allclose(tilt_reward(quat, jnp.float32(side)), reward, atol=2e-3)


def test_tilt_reward_is_continuous_where_assistive_gyms_jumps():
    """Tilts of a few milliradians to all sides: AG's Euler angle is then pi or -pi."""
    small = [turned(0.003, (np.cos(a), np.sin(a), 0)) for a in np.linspace(0, 2 * np.pi, 16)]
    assert np.ptp([tilt_now(q) for q in small]) < 0.01
    assert np.ptp([upstream_tilt(q) for q in small]) > 3.0
    upside_down = [turned(np.pi - x, (1.0, 0.0, 0.0)) for x in (-0.003, 0.003)]
    assert np.ptp([tilt_now(q) for q in upside_down]) < 0.01


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_tilt_reward_is_assistive_gyms_but_where_that_has_jumped(side: float):
    """All orientations: equal, or AG's is less because of the full turn that it does not take off."""
    rng = np.random.default_rng(0)
    equal = 0
    for quat in rng.normal(size=(200, 4)):
        quat = quat / np.linalg.norm(quat)
        ours, theirs = tilt_now(quat, side), upstream_tilt(quat, side)
        if abs(theirs) <= np.pi:
            equal += 1
            np.testing.assert_allclose(ours, theirs, atol=2e-3)
        else:
            np.testing.assert_allclose(ours, -2 * np.pi - theirs, atol=2e-3)
    assert equal > 100


def tilt_now(cup_quat_w: np.ndarray, side: float = 1.0) -> float:
    return float(tilt_reward(jnp.asarray(cup_quat_w, jnp.float32), jnp.float32(side)))


def upstream_tilt(cup_quat_w: np.ndarray, side: float = 1.0) -> float:
    """tasks.md section 5: -|phi - pi/2| of PR2, Baxter, Sawyer, -|phi + pi/2| of Jaco; phi is the roll of frame C."""
    h = 0.5**0.5
    frame = rotation_matrix(cup_quat_w, np) @ rotation_matrix(np.array([h, h, 0.0, 0.0]), np)
    return -abs(np.arctan2(frame[2, 1], frame[2, 2]) - side * np.pi / 2)


def test_reward_is_assistive_gyms():
    """R = -|mouth - top| - 0.01 |a|^2 + 0.1 r_tilt + (10 drunk - spilled) + r_pref."""
    tool = {
        "quat_w": turned(0.7, (1.0, 0.0, 0.0)), "vel_w": np.array([0.0, 0.3, 0.4]), "on_human": 12.0
    }  # fmt: skip
    up = rotation_matrix(tool["quat_w"], np)[:, 1]
    tool["pos_w"] = MOUTH + np.array([0.0, -0.3, 0.4]) - 0.115 * up
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    events = arrays({"drunk": 3.0, "spilled": 2.0, "hits": 5.0, "speed": 1.5})
    terms = TASK.rewards(state(), events, seen(tool, pushes=3.0), action)
    expected = {
        "distance": -1.0 * 0.5,
        "action": -0.01 * 2.0,
        "tilt": 0.1 * (-0.7 - np.pi / 2),  # tipped away from the person
        "water": 1.0 * (3 * 10 - 2 * 1),
        "preference_velocity": -0.25 * 0.5,  # config.ini human_preferences
        "preference_force_nontarget": -0.01 * 3.0,  # of the robot's body only
        "preference_high_forces": -0.05 * 12.0,
        "preference_food_hit": -1.0 * 5.0,
        "preference_food_velocities": -1.0 * 1.5,
    }
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-4, atol=1e-5, err_msg=name)


def test_weights_are_assistive_gyms():
    # tasks.md section 9
    c = TASK.config
    assert (c.distance, c.action, c.tilt, c.water, c.share) == (1.0, 0.01, 0.1, 1.0, 0.75)
    assert (c.drunk, c.spilled, c.mouth, c.fallen) == (10.0, 1.0, 0.03, 0.5)
    # sections 1.3, 1.5: 0.0155 rad in a control step of a full action, under 1 N m
    control = TASK.control
    free = control.action_scale * (1 - np.exp(-control.rate * control.period))
    np.testing.assert_allclose(free, 0.0155, atol=5e-5)
    assert np.isclose(control.period, 0.1) and control.max_torque == 1.0
    assert TASK.episode_length == 200 and TASK.gravity == 0.0 and TASK.water.gravity == -9.81
    assert (TASK.water.count, TASK.water.radius, TASK.water.mass) == (64, 0.005, 0.001)
    assert TASK.human.passive_mode == "frozen" and len(TASK.human.joints) == 4


def test_observations_have_the_references_sizes():
    robot, human = TASK.observe(state(), seen({"on_human": 2.0}, pushes=0.5))
    assert observe.flatten(robot).shape == (25,) and observe.flatten(human).shape == (23,)
    # the cup's place is that of its bottom, not of its top
    np.testing.assert_allclose(robot.tool_pos_mouth, CUP_AT - MOUTH, atol=1e-6)
    np.testing.assert_allclose(human.tool_pos_mouth, CUP_AT - MOUTH, atol=1e-6)
    assert float(robot.tool_on_human) == float(human.tool_on_human) == 2.0


def test_an_episode_begins_with_a_full_cup_and_holding_still_spills_nothing():
    begun = TASK.init(jax.random.PRNGKey(0), seen())
    local = np.asarray(begun.water.pos_w) - CUP_AT
    assert local.shape == (64, 3) and begun.water.alive.all() and float(begun.drunk) == 0
    # tasks.md section 5: mean height 19.5 mm, all within 28 mm of the axis, at most 36 mm high
    np.testing.assert_allclose(local.mean(0), (0, 0, 0.0195), atol=0.004)
    assert np.abs(local[:, :2]).max() < 0.030 and local[:, 2].max() < 0.040
    for _ in range(10):
        begun, events = advance(begun, seen())
        assert {k: float(v) for k, v in events.items()} == NOTHING
    assert begun.water.alive.all() and int(begun.lost) == 0


def test_a_cup_that_moves_takes_its_water_along():
    begun = TASK.init(jax.random.PRNGKey(0), seen())
    place = np.array(CUP_AT)
    for _ in range(10):  # 10 cm/s, faster than the arm reaches
        path = place + np.linspace(0, 1, TASK.control.frame_skip + 1)[:, None] * [0.01, 0.0, 0.0]
        begun, events = advance(begun, seen(path=path))
        place = path[-1]
        assert {k: float(v) for k, v in events.items()} == NOTHING
    np.testing.assert_allclose(np.asarray(begun.water.pos_w)[:, 0].mean() - place[0], 0, atol=0.01)


@pytest.mark.parametrize("robot", ROBOTS)
def test_start_positions_fill_the_references_box(robot: str):
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    share = (p - np.array([[-0.2, -0.5, 1.0]])) / 0.05
    assert p.shape == (2000, 1, 3) and (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()


def test_markers_are_the_water_that_is_there_and_the_mouth():
    now = state()
    now = replace(now, water=now.water.remove(jnp.arange(64) < 60))
    (water, radius, _), (mouth, _, green) = TASK.markers(now)
    assert np.isnan(water[:60]).all() and np.isfinite(water[60:]).all() and radius == 0.005
    np.testing.assert_allclose(mouth, MOUTH, atol=1e-6)
    assert green == (0.0, 1.0, 0.0, 1.0)


def test_more_water_than_the_cup_holds_is_refused():
    with pytest.raises(MatterError, match=r"5000 particles .* it holds \d+"):
        replace(TASK, water=replace(TASK.water, count=5000))
    with pytest.raises(MatterError, match="could cross a wall"):
        replace(TASK, control=replace(TASK.control, time_step=0.05, frame_skip=2))


# -- what the cup weighs -----------------------------------------------------------------------


def test_cup_weighs_what_is_in_it():
    up = np.asarray(axis(arrays(UPRIGHT)))
    inside = [CUP_AT + 0.02 * up, CUP_AT + 0.04 * up]
    drops = state([*inside, CUP_AT + np.array([0.3, 0.0, 0.0])])
    held, centre = held_by(drops.water, arrays(CUP_AT), arrays(UPRIGHT))
    assert float(held) == 2.0
    expected = (10 * (CUP_AT + 0.0525 * up) + sum(inside)) / 12
    np.testing.assert_allclose(centre, expected, atol=1e-6)
    weight, point = TASK.load(replace(drops, held=held, centre_w=centre))
    np.testing.assert_allclose(weight, 0.012 * 9.81, rtol=1e-6)
    np.testing.assert_allclose(point, centre)


@pytest.mark.parametrize("robot", ["PR2", "Sawyer"])
def test_weight_acts_on_the_arm_that_holds_the_cup(robot: str):
    scene = build_scene(TASK, ROBOTS[robot])
    controller, model, index = Controller.of(scene, TASK, False), scene.model, scene.index
    data = mujoco.MjData(model)
    low, high = model.jnt_range[index.robot_joint].T
    data.qpos[index.robot_qpos] = 0.6 * low + 0.4 * high
    mujoco.mj_forward(model, data)
    point, turn = data.site_xpos[index.tools[0].tip] + 0.05, np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, turn, None, point, index.tools[0].body)
    expected = turn.T[index.robot_dof] @ [0.0, 0.0, -0.7]
    np.testing.assert_allclose(controller.load_torque(data, 0.7, point, np), expected, atol=1e-6)
