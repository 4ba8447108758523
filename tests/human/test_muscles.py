# ruff: noqa: D103
"""Muscles: a bound on the torque, weakness, and tremor. Reference humans.md sections 6 and 7."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.human import muscles
from agym_jax.human.population import Human
from agym_jax.state import Episode
from agym_jax.tasks import TASKS

SPEC = TASKS["ScratchItch"].human
N = len(SPEC.joints)
GIRDLE = np.array(["clavicle" in name for name in SPEC.joints])  # deviation girdle-support


def _torque(target, angle, load, strength=1.0, moving=False) -> np.ndarray:
    full = lambda x: jnp.full(N, x, jnp.float32)  # noqa: E731
    mine = muscles.muscles_of(SPEC, jnp.float32(strength), jnp.bool_(moving))
    return np.asarray(mine.torque(full(target), full(angle), full(load)))


@pytest.mark.parametrize("strength", [0.25, 0.6, 1.0])
@pytest.mark.parametrize("moving", [False, True])
def test_torque_never_exceeds_the_bound(strength: float, moving: bool):
    rng = np.random.default_rng(0)
    for target, angle, load in rng.uniform(-3, 3, (50, 3)):
        torque = _torque(target, angle, load, strength, moving)
        muscle = torque - np.where(GIRDLE, load, 0.0)  # ligaments bear the girdle's load
        assert np.abs(muscle).max() <= strength * 1.0 + 1e-6
    # and reaches it, in either direction
    np.testing.assert_allclose(_torque(3, -3, 0, strength, moving), strength, rtol=1e-6)
    np.testing.assert_allclose(_torque(-3, 3, 0, strength, moving), -strength, rtol=1e-6)


def test_weak_person_cannot_hold_what_a_strong_one_holds():
    weight = 0.6  # [N m], between the weakest person's 0.25 and full strength's 1
    np.testing.assert_allclose(_torque(0.3, 0.3, weight, 1.0), weight, rtol=1e-6)
    assert GIRDLE.sum() == 3
    weak = _torque(0.3, 0.3, weight, 0.25)
    np.testing.assert_allclose(weak[~GIRDLE], 0.25, rtol=1e-6)
    np.testing.assert_allclose(weak[GIRDLE], weight, rtol=1e-6)
    # even half a radian of sag does not help
    np.testing.assert_allclose(_torque(0.3, -0.2, weight, 0.25)[~GIRDLE], 0.25, rtol=1e-6)


def test_full_action_against_a_blocked_joint_takes_the_bound():
    # AG: 5 x 0.05 rad at gain 0.05 a step of 0.02 s, 1 N m (tasks.md section 1.5)
    pull = _torque(0.25, 0.0, 0.0, 1.0, moving=True)
    assert (pull <= 1.0).all() and (pull > 0.99).all()


def test_damping_grows_with_strength_and_never_vanishes():
    still, moving = jnp.bool_(False), jnp.bool_(True)
    for how in (still, moving):
        weak, strong = (float(muscles.damping(SPEC, jnp.float32(s), how)) for s in (0.25, 1.0))
        assert 0 < weak < strong
    # a still person is the stiffer damper: hold_rate is a fifth of move_rate
    assert muscles.damping(SPEC, jnp.float32(1.0), still) > muscles.damping(
        SPEC, jnp.float32(1.0), moving
    )


def _episode(tremor: float, step: int) -> Episode:
    one = jnp.float32(1.0)
    human = Human(one, one, one, one, one, jnp.full(N, tremor, jnp.float32))
    pose = jnp.array([SPEC.pose.get(j, 0.0) for j in SPEC.joints], jnp.float32)
    return Episode(human, None, None, None, pose, pose, jnp.int32(step))  # ty: ignore


def test_tremor_alternates_around_the_held_pose_minus_first(static_env):
    # humans.md section 6: the counter is incremented before use, so the first step uses -A
    for step, sign in ((0, -1), (1, 1), (2, -1), (3, 1)):
        episode = _episode(0.1, step)
        target, hold = static_env.controller.human_target(
            episode, episode.human_target + 0.3, jnp.zeros(0)
        )
        np.testing.assert_allclose(target - episode.human_target, sign * 0.1, atol=1e-6)
        np.testing.assert_array_equal(hold, episode.human_target)


def test_active_person_acts_from_where_the_arm_is_and_a_trembling_one_from_the_pose(active_env):
    action = jnp.full(N, -0.2)  # x 0.25 rad
    for tremor in (0.0, 0.1):
        episode = _episode(tremor, 1)
        measured = np.asarray(episode.human_target) + 0.02
        target, hold = active_env.controller.human_target(episode, jnp.asarray(measured), action)
        start = np.asarray(episode.human_target) if tremor else measured
        low, high = active_env.scene.model.jnt_range[active_env.scene.index.human_joint].T
        expected = np.clip(start - 0.05, low, high)
        np.testing.assert_allclose(hold, expected, atol=1e-5)
        np.testing.assert_allclose(target, expected + tremor, atol=1e-5)


def test_only_active_and_trembling_people_move():
    assert not muscles.is_moving(jnp.zeros(N), False)
    assert muscles.is_moving(jnp.zeros(N), True)
    assert muscles.is_moving(jnp.zeros(N).at[3].set(-0.1), False)


def test_limp_arms_have_no_muscles_and_frozen_people_no_motion():
    limp, frozen = (dataclasses.replace(SPEC, passive_mode=x) for x in ("limp", "frozen"))
    still, moving, one = jnp.bool_(False), jnp.bool_(True), jnp.float32(1.0)
    load = jnp.full(N, 0.3)
    clavicles = np.array(["clavicle" in x for x in SPEC.joints])
    torque = muscles.muscles_of(limp, one, still).torque(jnp.ones(N), jnp.zeros(N), load)
    np.testing.assert_allclose(torque, np.where(clavicles, 0.3, 0.0))
    np.testing.assert_allclose(muscles.damping(limp, one, still), muscles.TISSUE_DAMPING)
    assert muscles.damping(frozen, one, still) > 1e3
    # an active or trembling person has the same muscles whatever a still one does
    for spec in (limp, frozen):
        mine, usual = (
            muscles.muscles_of(x, one, moving).torque(jnp.ones(N), jnp.zeros(N), load)
            for x in (spec, SPEC)
        )
        np.testing.assert_allclose(mine, usual)


def test_mattress_bears_the_arm_of_who_lies_down():
    lying = dataclasses.replace(SPEC, postures="BedBathing", passive_mode="limp")
    mine = muscles.muscles_of(lying, jnp.float32(1.0), jnp.bool_(False))
    torque = mine.torque(jnp.zeros(N), jnp.zeros(N), jnp.full(N, 0.3))
    np.testing.assert_array_equal(torque, 0.0)
