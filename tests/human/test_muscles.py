# ruff: noqa: D103
"""Muscles: a bound on the torque, weakness, and tremor. Reference humans.md sections 6 and 7."""

from __future__ import annotations

import copy
import dataclasses

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.human import muscles
from agym_jax.human.population import Human
from agym_jax.robots import ROBOTS
from agym_jax.sim.motors import Aim, Motors
from agym_jax.sim.scene import build_scene
from agym_jax.state import Episode
from agym_jax.tasks import TASKS

SPEC = TASKS["ScratchItch"].human
N = len(SPEC.joints)
GIRDLE = np.array(["clavicle" in name for name in SPEC.joints])  # deviation girdle-support


def _muscles(strength: float = 1.0, moving: bool = False, spec=SPEC) -> muscles.Muscles:
    return muscles.muscles_of(spec, jnp.float32(strength), jnp.bool_(moving))


@pytest.mark.parametrize("strength", [0.25, 0.6, 1.0])
def test_the_bound_is_the_strength_and_the_rate_says_who_moves(strength: float):
    for moving, rate in ((False, SPEC.hold_rate), (True, SPEC.move_rate)):
        mine = _muscles(strength, moving)
        np.testing.assert_allclose(mine.bound, strength * SPEC.max_torque, rtol=1e-6)
        np.testing.assert_allclose(mine.rate, rate, rtol=1e-6)
        np.testing.assert_allclose(mine.damping, muscles.TISSUE_DAMPING, rtol=1e-6)
        np.testing.assert_array_equal(mine.passive, GIRDLE)


class _Arm:
    """A held arm in C MuJoCo, without gravity, and a torque on one of its joints."""

    def __init__(self, strength: float, target: float = 0.0, moving: bool = False) -> None:
        task, robot = TASKS["ScratchItch"], ROBOTS["Jaco"]
        self.scene = build_scene(task, robot)
        self.model = copy.copy(self.scene.model)
        self.model.opt.gravity[:] = 0.0
        self.model.pair_margin[:] = -1.0  # nothing touches
        self.model.dof_armature[self.scene.index.robot_dof] = 1e6  # nobody drives it
        self.model.jnt_limited[self.scene.index.robot_joint] = 0
        self.dofs = self.scene.index.human_dof
        mine = _muscles(strength, moving)
        self.model.dof_frictionloss[self.dofs] = mine.bound
        self.model.dof_damping[self.dofs] = mine.damping
        self.motors = Motors.of(self.model, self.dofs, task.control.time_step)
        self.data = mujoco.MjData(self.model)
        q = self.data.qpos[self.scene.index.human_qpos]
        goal = q + target * (np.array(self.scene.moving) == "r_elbow_x")
        self.aim = Aim(goal, float(mine.rate), float(mine.bound), float(mine.damping))
        mujoco.mj_forward(self.model, self.data)

    def pushed(self, joint: str, torque: float, steps: int = 50) -> float:
        """How far the joint has moved in the end [rad]."""
        i = self.scene.moving.index(joint)
        before = self.data.qpos[self.scene.index.human_qpos[i]]
        push = np.zeros(len(self.dofs))
        push[i] = torque
        for _ in range(steps):
            load = self.data.qfrc_bias[self.dofs].copy()
            self.motors.prepare(self.model, self.data, self.aim, load - push, push)
            mujoco.mj_step(self.model, self.data)
        assert not any(warning.number for warning in self.data.warning)  # it was not reset
        return self.data.qpos[self.scene.index.human_qpos[i]] - before


@pytest.mark.parametrize("strength", [0.25, 1.0])
def test_a_held_arm_stands_still_up_to_its_strength_and_gives_way_beyond_it(strength: float):
    assert abs(_Arm(strength).pushed("r_elbow_x", 0.9 * strength)) < 0.01
    assert abs(_Arm(strength).pushed("r_elbow_x", -1.5 * strength)) > 0.2


def test_a_target_is_reached_against_less_than_the_bound_only():
    for torque in (0.0, 0.5):
        moved = _Arm(1.0, target=-0.25, moving=True).pushed("r_elbow_x", torque, steps=150)
        np.testing.assert_allclose(moved, -0.25, atol=0.02)
    assert _Arm(1.0, target=-0.25, moving=True).pushed("r_elbow_x", 1.3) > -0.05


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
    mine = _muscles(spec=limp)
    assert mine.bound == 0.0
    np.testing.assert_array_equal(mine.passive, GIRDLE)
    np.testing.assert_allclose(mine.damping, muscles.TISSUE_DAMPING)
    mine = _muscles(spec=frozen)
    assert mine.bound == 0.0 and mine.damping > 1e3
    # an active or trembling person has the same muscles whatever a still one does
    for spec in (limp, frozen):
        for a, b in zip(_muscles(moving=True, spec=spec), _muscles(moving=True), strict=True):
            np.testing.assert_allclose(a, b)


def test_limits_depend_on_the_pose_of_an_arm_but_for_still_people_with_ags_masses():
    strength, still = jnp.float32(1.0), jnp.bool_(False)
    for at_joints, active, limited in ((0, False, 1), (0, True, 1), (1, False, 0), (1, True, 1)):
        mine = muscles.muscles_of(SPEC, strength, still, jnp.float32(at_joints), active)
        assert mine.limited.shape == () and mine.limited == limited


def test_mattress_bears_the_arm_of_who_lies_down():
    lying = dataclasses.replace(SPEC, postures="BedBathing", passive_mode="limp")
    np.testing.assert_array_equal(_muscles(spec=lying).passive, 0.0)
