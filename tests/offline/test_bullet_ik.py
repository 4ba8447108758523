# ruff: noqa: D103
"""Inverse kinematics as Bullet's, against the chains that C MuJoCo has been held against. NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from agym_jax.math3d import first_sign, rotation_matrix
from agym_jax.offline import bullet_ik, kinematics
from agym_jax.offline.base_search import Reach
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS


@pytest.fixture(scope="module")
def jaco() -> Reach:
    return Reach(TASKS["ScratchItch"], ROBOTS["Jaco"], np.random.default_rng(0))


def test_forward_kinematics_are_the_chains(jaco: Reach):
    angles = np.random.default_rng(1).uniform(-3, 3, (4, 7))
    tips, rots, jacobians = jaco.solvers[0].forward(angles.T)
    for i, q in enumerate(angles.astype(np.float32)):
        tip, rot, jacobian = kinematics.forward(jaco.chains[0], q)
        np.testing.assert_allclose(tips[:, i], tip, atol=5e-6)
        np.testing.assert_allclose(rots[:, :, i], rot, atol=5e-6)
        np.testing.assert_allclose(jacobians[:, :, i], jacobian, atol=5e-6)


def test_quaternions_have_bullets_sign():
    quats = np.random.default_rng(2).normal(size=(50, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    found = bullet_ik.bullet_quat(np.moveaxis(rotation_matrix(quats, np), 0, -1)).T
    np.testing.assert_allclose(found, first_sign(quats), atol=1e-6)


def test_solutions_are_reached_and_pulled_towards_the_rest_pose(jaco: Reach):
    rng = np.random.default_rng(3)
    solver, limits = jaco.solvers[0], jaco.limits[0]
    middle = (limits.lower + limits.upper) / 2
    goals = middle + rng.uniform(-0.6, 0.6, (16, 7))
    tip, rot, _ = solver.forward(goals.T)
    start = goals + rng.uniform(-0.2, 0.2, goals.shape)
    solved = [
        solver.solve(start, rest, tip.T, np.moveaxis(rot, -1, 0), 400)
        for rest in (goals + 1.0, goals - 1.0)
    ]
    for q in solved:
        found, turned, _ = solver.forward(q.T)
        assert np.linalg.norm(found - tip, axis=0).max() < 0.03
        assert np.abs(turned - rot).max() < 0.05
    # one degree of freedom is left: the solutions differ, each towards its rest pose
    assert np.abs(solved[0] - solved[1]).max(axis=1).min() > 0.01
    assert ((solved[0] - solved[1]).sum(axis=1) > 0).mean() > 0.8


def test_without_a_rotation_the_orientation_is_free(jaco: Reach):
    solver = jaco.solvers[0]
    goal = solver.forward(np.full((7, 1), 1.5))[0].T
    q = solver.solve(np.full((1, 7), 1.0), np.zeros((1, 7)), goal, None, 200)
    assert np.linalg.norm(solver.forward(q.T)[0].T - goal) < 0.01


def test_half_a_turn_goes_the_way_that_is_asked_for(jaco: Reach):
    turns = []
    for way in (1.0, -1.0):
        solver = bullet_ik.Solver(jaco.chains[0], jaco.limits[0], way)
        tip, rot, _ = solver.forward(np.full((7, 1), 2.0))
        away = np.diag([1.0, -1.0, -1.0]) @ rot[:, :, 0]
        q = solver.solve(np.full((1, 7), 2.0), np.full((1, 7), 2.0), tip.T, away[None], 1)
        turns.append(solver.forward(q.T)[1][:, :, 0] @ rot[:, :, 0].T)
    about_x = [r[2, 1] - r[1, 2] for r in turns]
    assert about_x[0] * about_x[1] < 0


def test_isotropy_falls_at_a_joint_limit(jaco: Reach):
    solver, limits = jaco.solvers[0], jaco.limits[0]
    inside = np.random.default_rng(4).uniform(1.2, 2.8, (1, 7))
    at_limit = np.where(limits.upper - limits.lower < 6.0, limits.lower, inside)
    endless = np.zeros(7, bool)
    good, bad = (
        float(bullet_ik.isotropy(solver.forward(q.T)[2], q.T, limits, endless)[0])
        for q in (inside, at_limit)
    )
    assert 0.0 <= bad < good <= 1.0
