# ruff: noqa: D103
"""Dressing by hand: reference tasks.md section 6 and humans.md section 9, without MJX."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scene import Pull, along_forearm, before_hand, draw_pull, pull_on
from cloth_scene import arm_of as limb_of
from dress_scene import ELBOW, SHOULDER, WRIST, seen
from meal_scene import CHEST, TORSO

from agym_jax import observe
from agym_jax.errors import SpecError
from agym_jax.human.anthropometry import dims
from agym_jax.matter.cloth import solver as fabrics
from agym_jax.matter.cloth.obstacles import obstacles, on_limbs
from agym_jax.matter.cloth.sleeve import SleeveState
from agym_jax.matter.cloth.solver import MAX_SLIP, ClothContact
from agym_jax.robots import ROBOTS
from agym_jax.sense import LinkMotion
from agym_jax.spec import Preferences
from agym_jax.tasks.dressing import (
    AG_FORCE,
    BELOW_HAND,
    DRESSING,
    START,
    Config,
    felt,
    held_at,
)  # fmt: skip

TASK = DRESSING
HIP = np.array([0.1, -0.02, 0.6])


@cache
def start():
    return TASK.init(jax.random.PRNGKey(0), seen())


@cache
def advance():
    return jax.jit(TASK.advance)


def test_at_rest_it_only_settles_on_the_hand():
    state, first = start(), start()
    for _ in range(5):
        state, events = advance()(state, seen())
    assert events == {} and not state.slid.any() and state.force.sum() < 2.0
    assert first.dressed < state.dressed < -0.05  # the gown swings back to the hand


def test_the_gown_follows_the_hand_at_every_physics_step():
    away = np.array(START) + np.linspace(0, 1, 11)[:, None] * [0.0, -0.03, 0.05]
    after, _ = advance()(start(), seen(away))
    held = after.cloth.pos_w[TASK.spec.garment.anchors].mean(0)
    np.testing.assert_allclose(held, away[-1] - [0, 0, BELOW_HAND], atol=1e-5)


def test_it_presses_on_the_limb_that_it_lies_on():
    over = np.array([0.4538, -0.15, 0.9831 + 0.08])  # the forearm, from above
    state = TASK.init(jax.random.PRNGKey(0), seen(np.tile(over, (11, 1))))
    for _ in range(3):
        state, _ = advance()(state, seen(np.tile(over, (11, 1))))
    arm = state.force[:3].sum()  # ARM_LINKS come first
    assert 0.01 < arm < 5.0 and arm > 0.99 * state.force.sum()


def test_a_gown_that_blew_up_says_nan_and_is_finite():
    state = start()
    wild = replace(state, cloth=replace(state.cloth, vel_w=state.cloth.vel_w.at[5].set(jnp.nan)))
    after, _ = advance()(wild, seen())
    assert jnp.isnan(after.force).all() and jnp.isfinite(after.cloth.pos_w).all()
    robot, _ = TASK.observe(after, seen())
    assert jnp.isnan(robot.cloth_force)  # ends the episode: env.py guards the observation


def test_the_patch_keeps_its_direction():
    here, there = (held_at(TASK.spec, jnp.array(p)) for p in ([0.0, 0.0, 0.0], [0.3, -0.2, 0.1]))
    np.testing.assert_allclose(there - here, np.tile([0.3, -0.2, 0.1], (len(here), 1)), atol=1e-6)
    assert np.ptp(here[:, 0]) > 0.05 > np.ptp(here[:, 1])
    np.testing.assert_allclose(here.mean(0), [0, 0, -BELOW_HAND], atol=1e-6)


def test_reward_is_assistive_gyms():
    """R = r_dress - 0.01 |a|^2 - 0.25 v - 0.01 of AG's number of the gown; the robot's touch costs nothing."""
    state = replace(start(), dressed=jnp.float32(0.37), force=jnp.arange(10.0))
    now = seen(vel_w=np.array([0.0, 0.3, 0.4]), on_human=12.0)
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    terms = TASK.rewards(state, {}, now, action)
    expected = {
        "dressing": 0.37, "action": -0.01 * 2.0,
        "preference_velocity": -0.25 * 0.5, "preference_dressing_force": -0.01 * AG_FORCE * 45.0,
    }  # fmt: skip
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-5, err_msg=name)


@pytest.mark.parametrize(("best", "won"), [(0.399, False), (0.4, True)])
def test_success_at_40_cm_ever(best: float, won: bool):
    state = replace(start(), best=jnp.float32(best), dressed=jnp.float32(-0.3))
    assert bool(TASK.success(state)) == won


def test_the_best_stays_and_the_sleeve_is_remembered_for_a_moment():
    state = replace(
        start(), on_arm=SleeveState(jnp.bool_(True), jnp.bool_(False)), best=jnp.float32(0.3)
    )
    after, _ = advance()(state, seen())
    assert after.on_arm.forearm and after.on_arm.steps_off == 1
    assert np.isclose(after.best, 0.3) and after.dressed < after.best
    long_ago = replace(state, on_arm=replace(state.on_arm, steps_off=jnp.int32(5)))
    after, _ = advance()(long_ago, seen())
    assert not after.on_arm.forearm and np.isclose(after.best, 0.3)


def test_weights_are_assistive_gyms():
    c, p, control = TASK.config, Preferences(), TASK.control
    assert (c.dressing, c.action, c.dressed, p.dressing_force) == (1.0, 0.01, 0.4, 0.01)
    # section 1.5: 0.0196 rad in a control step of a full action, under 4 N m
    free = control.action_scale * (1 - np.exp(-control.rate * control.period))
    np.testing.assert_allclose(free, 0.0196, atol=5e-5)
    assert np.isclose(control.period, 0.1) and control.max_torque == 4.0
    assert TASK.episode_length == 200 and TASK.gravity == -1.0 and TASK.fabric.gravity == -9.81
    assert TASK.human.passive_mode == "frozen" and len(TASK.human.joints) == 10
    assert all(joint.startswith("l_") for joint in TASK.human.joints)
    assert np.isclose(TASK.human.pose["l_shoulder_y"], np.deg2rad(-80))
    assert set(TASK.human.impairments) == {"none", "limits", "weakness", "tremor"}


def test_observations_are_differences_along_world_axes():
    state = replace(start(), force=jnp.arange(10.0))
    quat = np.array([0.5, 0.5, -0.5, 0.5])
    now = replace(seen(quat_w=quat), robot_on_human=jnp.float32(0.5))
    robot, human = TASK.observe(state, now)
    joints = np.concatenate([SHOULDER, ELBOW, WRIST]).reshape(3, 3)
    flat = np.concatenate
    expected = flat(
        [np.subtract(START, TORSO), quat, np.arange(7), (joints - TORSO).ravel(), [AG_FORCE * 45.0]]
    )
    np.testing.assert_allclose(observe.flatten(robot), expected, atol=1e-5)
    expected = flat(
        [
            np.subtract(START, CHEST),
            quat,
            np.arange(10),
            (joints - CHEST).ravel(),
            [AG_FORCE * 45.0, 0.5],
        ]
    )
    np.testing.assert_allclose(observe.flatten(human), expected, atol=1e-5)
    assert (len(observe.flatten(robot)), len(observe.flatten(human))) == (24, 28)


def test_starts_vary_by_5_cm():
    starts = np.array(
        [TASK.start(k, "PR2")[0] for k in jax.random.split(jax.random.PRNGKey(0), 64)]
    )
    off = starts - START
    assert np.abs(off).max() <= 0.05 and np.ptp(off, axis=0).min() > 0.07


def test_the_gown_is_drawn_as_a_surface():
    (gown,) = TASK.surfaces(start())
    assert gown.vertices.shape == TASK.spec.garment.vertices.shape and len(gown.triangles) > 1000
    assert TASK.markers(start()) == []


def test_arms_taper_in_a_share_of_the_episodes():
    assert TASK.config.tapered_arms == 0 and start().tapered == 0
    some = replace(TASK, config=Config(tapered_arms=0.25))
    keys, s = jax.random.split(jax.random.PRNGKey(0), 400), seen()
    drawn = jax.jit(jax.vmap(lambda key: some.init(key, s).tapered))(keys)
    assert set(drawn.tolist()) == {0.0, 1.0} and 0.19 < drawn.mean() < 0.31
    with pytest.raises(SpecError, match=r"between 0 and 1; got 1\.5"):
        Config(tapered_arms=1.5)


def test_the_grid_is_for_the_arm_and_nothing_else(monkeypatch):
    some, given = replace(TASK, config=Config(tapered_arms=0.5)), []
    nothing = jnp.zeros(3)

    def step(spec, cloth, before, after, *others):
        given.append((after, others[-2]))
        still = ClothContact(jnp.zeros((1, 3)), jnp.zeros(1), nothing, jnp.float32(1), False)
        return cloth, still

    monkeypatch.setattr(fabrics, "step", step)
    with jax.disable_jit():
        for tapered in (0.0, 1.0):
            some._move(replace(start(), tapered=jnp.float32(tapered)), seen())
        TASK._move(start(), seen())
    (_, off), (solids, on), (_, left_out) = given[0], given[10], given[20]
    assert len(given) == 30 and left_out is None and (off.on, on.on) == (0.0, 1.0)
    count = len(solids.radius)
    assert on.which == (0, 1, 2, *range(count - 3, count)) and on.rot_w.shape == (count, 3, 3)
    along = solids.b_w - solids.a_w  # upper arm and forearm are along z of their grids
    for limb in (0, 1):
        unit = along[limb] / jnp.linalg.norm(along[limb])
        np.testing.assert_allclose(abs(on.rot_w[limb, :, 2] @ unit), 1.0, atol=1e-5)
    np.testing.assert_allclose(on.rot_w[count - 3 :], on.rot_w[:3])  # joints turn with the limbs


def test_the_gown_meets_the_robot_in_a_share_of_the_episodes(monkeypatch):
    s = seen()
    n = len(s.motion.tool_pos_w)
    pos = jnp.arange(float(n))[:, None, None] * jnp.array([[[0.01, 0.0, 0.0]]])
    arm = LinkMotion("Jaco", ("j2s7s300_link_2",), pos, jnp.broadcast_to(jnp.eye(3), (n, 1, 3, 3)))
    there = replace(s, motion=replace(s.motion, robot=arm))
    some, given = replace(TASK, config=Config(meets_robot=0.25)), []
    keys = jax.random.split(jax.random.PRNGKey(0), 400)
    drawn = jax.jit(jax.vmap(lambda key: some.init(key, there).meets))(keys)
    assert set(drawn.tolist()) == {0.0, 1.0} and 0.19 < drawn.mean() < 0.31
    with pytest.raises(SpecError, match=r"meets_robot .* between 0 and 1; got -1"):
        Config(meets_robot=-1.0)
    other = replace(s, motion=replace(s.motion, robot=replace(arm, robot="Panda")))
    with pytest.raises(SpecError, match=r"nothing was recorded of Panda"):
        some.init(keys[0], other)

    def step(spec, cloth, *others):
        given.append(others[-1])
        nothing, none = jnp.zeros(3), jnp.zeros(1)
        return cloth, ClothContact(none[None], none, nothing, jnp.float32(1), jnp.bool_(False))

    monkeypatch.setattr(fabrics, "step", step)
    with jax.disable_jit():
        some._move(replace(start(), meets=jnp.float32(1)), there)
        TASK._move(start(), there)
    (first, *_), left_out = given[: n - 1], given[n - 1 :]
    assert len(given) == 2 * (n - 1) and set(left_out) == {None} and first.meets == 1
    assert len(first.grids.layouts) == 1  # that of the link that it was given
    np.testing.assert_allclose(first.end - first.start, [[0.01] + [0.0] * 11], atol=1e-6)


def test_spheres_are_at_the_joints_of_the_arm_and_press_on_its_limbs():
    limbs = "left_upper_arm", "left_forearm", "left_hand"
    shoulder, elbow, wrist = (0.0, 0.0, 1.5), (0.0, 0.0, 1.2), (0.0, 0.0, 0.95)
    joints = np.array([shoulder, elbow, wrist])
    where = {x: jnp.asarray(joints[[i]], jnp.float32) for i, x in enumerate(limbs)}
    d, turned = dims(0.0), dict.fromkeys(limbs, jnp.eye(3)[None])
    a, b, radius = obstacles(d, limbs, where, turned, joints=True)
    without = obstacles(d, limbs, where, turned)[2]
    assert len(radius) == len(without) + 3
    np.testing.assert_allclose(a[0, -3:], b[0, -3:])
    np.testing.assert_allclose(a[0, -3:], joints)
    np.testing.assert_allclose(radius[-3:], [d.upper_arm_r, d.upper_arm_r, d.forearm_r])
    total = jnp.arange(1.0, 1.0 + len(radius))
    np.testing.assert_allclose(on_limbs(total, limbs, joints=True), [1 + 6 + 7, 2 + 8, 3])
    np.testing.assert_allclose(on_limbs(total[:-3], limbs, joints=False), [1, 2, 3])
    head = on_limbs(jnp.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0]), ("head", "neck"), joints=False)
    np.testing.assert_allclose(head, [1 + 2 + 4, 8])  # with face and nose; nobody is the armrest


@pytest.mark.parametrize(("tapered", "per_newton"), [(0.0, 2.3), (1.0, 5.3)])
def test_a_newton_counts_for_more_on_an_arm_as_assistive_gyms_cloth_finds_it(
    tapered: float, per_newton: float
):
    state = replace(start(), force=start().force.at[:2].set(1.5), tapered=jnp.float32(tapered))
    assert float(felt(state)) == pytest.approx(3.0 * per_newton)


def test_every_robot_has_a_start_for_it():
    for robot in ROBOTS.values():
        assert "Dressing" in robot.start_rotations
        assert robot.fixed_base(TASK) is not None or "Dressing" in robot.searches


@pytest.mark.slow
def test_pulls_dress_people_of_all_sizes_and_no_limb_passes_through():
    pulls = jax.vmap(draw_pull)(jax.random.split(jax.random.PRNGKey(0), 4))
    pulls = replace(pulls, speed=jnp.full(4, 0.3))
    steps = 550
    out = jax.jit(lambda p: jax.lax.map(lambda x: pull_on(TASK.spec, x, steps)[0], p))(pulls)
    assert (out.through == 0).all() and not out.broken.any()
    assert (out.best > 0.4).all() and (out.progress > 0.6).all()
    assert (out.deepest < 0.015).all() and (out.force < 20.0).all() and (out.force > 0.1).all()
    assert (out.slid < 0.05).all()  # the grip holds


CAUGHT = {
    "the sleeve is on the forearm, and is lifted": lambda a: (
        [before_hand(a), a.elbow_w + 0.1 * along_forearm(a), 0.5 * (a.wrist_w + a.elbow_w) + jnp.array([0, 0, 0.9])]
    ),
    "it lies against the inside of the elbow, and is pulled on": lambda a: (
        [before_hand(a), a.elbow_w, a.elbow_w + 2.6 * (a.shoulder_w - a.elbow_w)]
    ),
    "the cuff is at the elbow, and is pulled on along the forearm": lambda a: (
        [before_hand(a), a.elbow_w + 0.8 * along_forearm(a), a.elbow_w + 0.8 * along_forearm(a)]
    ),
}  # fmt: skip
"""Places of the hand that pull a gown through a limb, if the grip never gives way."""


@cache
def pull_through() -> Any:
    """What comes of a pull whose hand passes three places (3, 3), compiled."""
    return jax.jit(lambda pull, places: pull_on(TASK.spec, pull, 480, lambda _: places)[0])


@pytest.mark.parametrize("how", CAUGHT)
def test_a_gown_that_is_caught_slides_through_the_fingers_not_through_the_limb(how: str):
    one, speed = jnp.float32(1.0), jnp.float32(0.4)
    pull = Pull(one, one, jnp.zeros(3), speed, jnp.float32(np.pi / 2))
    out = pull_through()(pull, jnp.stack(CAUGHT[how](limb_of(pull)[0])))
    assert out.through == 0 and not out.broken
    assert out.slid > 0.1  # it would have gone through


def test_the_hand_and_what_it_holds_part_while_the_gown_is_caught():
    state = replace(start(), slid=jnp.array([0.14, 0.0, 0.0]))
    after, _ = advance()(state, seen())
    assert 0.0 < after.slid[0] < 0.14 and not after.slid[1:].any()  # it is gathered in again
    held = after.cloth.pos_w[TASK.spec.garment.anchors].mean(0)
    expected = np.array(START) - [0, 0, BELOW_HAND] + after.slid
    np.testing.assert_allclose(held, expected, atol=0.01)


def test_a_gown_of_which_too_much_has_slid_through_is_out_of_the_hand():
    far = jnp.array([MAX_SLIP + 0.01, 0.0, 0.0])
    cloth = start().cloth
    assert TASK.measure(start())["held"] == 1.0
    state = replace(start(), slid=far, cloth=replace(cloth, pos_w=cloth.pos_w + far))
    heights = [float(state.cloth.pos_w[:, 2].mean())]
    for _ in range(5):
        state, _ = advance()(state, seen())
        assert np.array_equal(state.slid, far)  # and stays so
        assert TASK.measure(state)["held"] == 0.0
        heights.append(float(state.cloth.pos_w[:, 2].mean()))
    assert heights[0] - heights[-1] > 0.4  # half a second of falling, on nothing that would stop it
