# ruff: noqa: D103
"""Chains against C MuJoCo, and every start pose of the banks."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.data import banks as placement
from agym_jax.errors import SpecError
from agym_jax.human import pose as human_pose
from agym_jax.math3d import axis_angle_matrix, rotation_error, rotation_matrix
from agym_jax.offline import kinematics
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS

TASK, ROBOT = TASKS["ScratchItch"], ROBOTS["Jaco"]
SCENE = build_scene(TASK, ROBOT)
INDEX, MODEL = SCENE.index, SCENE.model
SITE = MODEL.site(f"robot/{SCENE.arms[0].end_effector}").id
CHAIN = kinematics.chain_of(MODEL, INDEX.robot_joint, SITE, INDEX.robot_base)
BASE_POS, BASE_ROT = (
    MODEL.body_pos[INDEX.robot_base],
    rotation_matrix(MODEL.body_quat[INDEX.robot_base], np),
)
REACHED, REACHED_ROTATION = 0.001, 0.01
"""What counts as reached [m], [rad]."""
forward = jax.jit(jax.vmap(lambda q: kinematics.forward(CHAIN, q)))


def _angles(n: int, seed: int = 0) -> np.ndarray:
    low, high = np.maximum(CHAIN.lower, -np.pi), np.minimum(CHAIN.upper, np.pi)
    return np.random.default_rng(seed).uniform(
        low, np.where(high > low, high, CHAIN.upper), (n, len(low))
    )


def _c_pose(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, mujoco.MjData]:
    data = mujoco.MjData(MODEL)
    data.qpos[INDEX.robot_qpos] = angles
    mujoco.mj_kinematics(MODEL, data)
    mujoco.mj_comPos(MODEL, data)
    pos = BASE_ROT.T @ (data.site_xpos[SITE] - BASE_POS)
    return pos, BASE_ROT.T @ data.site_xmat[SITE].reshape(3, 3), data


def test_forward_kinematics_and_jacobian_equal_mujocos():
    angles = _angles(16)
    for q, pos, rot, jacobian in zip(angles, *map(np.asarray, forward(angles)), strict=True):
        c_pos, c_rot, data = _c_pose(q)
        np.testing.assert_allclose(pos, c_pos, atol=2e-6)  # float32 over seven joints, 1 m
        np.testing.assert_allclose(rot, c_rot, atol=2e-6)
        linear, angular = np.zeros((2, 3, MODEL.nv))
        mujoco.mj_jacSite(MODEL, data, linear, angular, SITE)
        np.testing.assert_allclose(jacobian[:3], BASE_ROT.T @ linear[:, INDEX.robot_dof], atol=4e-6)
        np.testing.assert_allclose(
            jacobian[3:], BASE_ROT.T @ angular[:, INDEX.robot_dof], atol=4e-6
        )


def test_jacobian_is_the_derivative():
    q, h = _angles(1, seed=1)[0], 1e-4
    _, _, jacobian = (np.asarray(x[0]) for x in forward(q[None]))
    for i in range(len(q)):
        ahead, behind = q.copy(), q.copy()
        ahead[i], behind[i] = q[i] + h, q[i] - h
        (p1, r1, _), (p0, r0, _) = _c_pose(ahead), _c_pose(behind)  # C is in float64
        np.testing.assert_allclose(jacobian[:3, i], (p1 - p0) / (2 * h), atol=1e-5)
        turn = np.asarray(rotation_error(jnp.asarray(r0), jnp.asarray(r1)))
        # the error is in float32, 6e-8 over 2e-4
        np.testing.assert_allclose(jacobian[3:, i], turn / (2 * h), atol=2e-3)


def test_inverse_reaches_what_can_be_reached():
    goals = _angles(24, seed=2)
    pos, rot, _ = forward(goals)
    starts = jnp.asarray(_angles(12, seed=3), jnp.float32)

    @jax.jit
    def solve(pos, rot):
        one = lambda p, r, s: kinematics.inverse(CHAIN, s, p, r)  # noqa: E731
        return jax.vmap(lambda p, r: jax.vmap(lambda s: one(p, r, s))(starts))(pos, rot)

    angles, distance, turn = (np.asarray(x) for x in solve(pos, rot))
    reached = (distance < REACHED) & (turn < REACHED_ROTATION)
    # every goal is some pose's, so 12 beginnings find nearly all of them
    assert reached.any(1).mean() >= 0.9
    assert (angles >= CHAIN.lower).all() and (angles <= CHAIN.upper).all()
    for i, j in zip(*np.nonzero(reached), strict=True):  # and what it claims is true
        c_pos, c_rot, _ = _c_pose(angles[i, j])
        assert np.linalg.norm(c_pos - np.asarray(pos[i])) < REACHED + 1e-5
        cosine = (np.trace(c_rot @ np.asarray(rot[i]).T) - 1) / 2
        assert np.arccos(np.clip(cosine, -1, 1)) < REACHED_ROTATION + 1e-3


def test_inverse_without_weight_leaves_the_orientation_free():
    goal = _angles(1, seed=5)[0]
    pos, rot, _ = (x[0] for x in forward(goal[None]))
    turned = jnp.asarray(rot) @ axis_angle_matrix(jnp.array([1.0, 0.0, 0.0]), 2.0)
    start = jnp.asarray(goal + 0.1, jnp.float32)
    free, distance, turn = kinematics.inverse(CHAIN, start, pos, turned, weight=0.0)
    c_pos, c_rot, _ = _c_pose(np.asarray(free))
    assert distance < REACHED and np.linalg.norm(c_pos - np.asarray(pos)) < REACHED
    # the rest of the way is still told, and near what it was
    cosine = (np.trace(c_rot.T @ np.asarray(turned)) - 1) / 2
    np.testing.assert_allclose(turn, np.arccos(cosine), atol=1e-3)
    assert turn > 1.0


def test_inverse_reports_the_error_of_an_unreachable_pose():
    far = jnp.array([3.0, 0.0, 0.0])  # Jaco is 1 m long
    _, distance, _ = kinematics.inverse(CHAIN, jnp.asarray(_angles(1)[0]), far, jnp.eye(3), steps=5)
    assert distance > 1.5


def test_chain_refuses_a_site_of_another_body():
    chest = INDEX.human_body[INDEX.links.index("chest")]
    with pytest.raises(SpecError, match="does not hang on body"):
        kinematics.chain_of(MODEL, INDEX.robot_joint, INDEX.tools[0].tip, chest)
    with pytest.raises(SpecError, match="1 joints are not between"):
        joints = np.append(INDEX.robot_joint, INDEX.human_joint[0])
        kinematics.chain_of(MODEL, joints, SITE, INDEX.robot_base)


def test_every_bank_row_reaches_assistive_gyms_start():
    bank = placement.load_bank(TASK, ROBOT)
    assert len(bank.arm_angles) >= 480
    # robots.md section 7: Jaco beside the wheelchair
    np.testing.assert_allclose(bank.base_pos, [[-0.35, -0.3, 0.36]] * len(bank.base_pos), atol=1e-6)
    assert (bank.arm_angles >= CHAIN.lower - 1e-5).all() and (
        bank.arm_angles <= CHAIN.upper + 1e-5
    ).all()
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for angles in bank.arm_angles:
        pos, rot, _ = _c_pose(angles)
        pos, rot = BASE_POS + BASE_ROT @ pos, BASE_ROT @ rot
        # tasks.md section 2: (-0.5, 0, 0.8) + U(-0.05, 0.05)^3, Euler (0, pi/2, 0): z along world x
        # reached within 0.03 m and a quaternion 0.03 away, as Assistive Gym has it
        assert np.abs(pos - [-0.5, 0.0, 0.8]).max() < 0.05 + 0.03
        assert np.arccos(min(1.0, rot[0, 2])) < 0.06
        low, high = np.minimum(low, pos), np.maximum(high, pos)
    assert (high - low > 0.09).all()  # the box is filled


def test_bank_rows_are_contact_free():
    for sex, model in enumerate((SCENE.model, SCENE.female)):
        typical = human_pose.typical(TASK.human, sex)
        pose = human_pose.start_angles(typical, SCENE.moving, 1.0, np)
        data = mujoco.MjData(model)
        for angles in placement.load_bank(TASK, ROBOT).arm_angles:
            data.qpos[INDEX.robot_qpos], data.qpos[INDEX.human_qpos] = angles, pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            names = [model.geom(g).name for c in data.contact for g in c.geom]
            assert not any(n.startswith(("robot/", "tool/")) for n in names), names
