# ruff: noqa: D103
"""Quaternions and rotations against MuJoCo; distances between capsules against sampling and MuJoCo."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.math3d import (
    axis_angle_matrix,
    axis_angle_quat,
    capsule_gap,
    child_pose,
    child_quat,
    first_sign,
    nearest_sign,
    quat_mul,
    rotate,
    rotate_inverse,
    rotation_error,
    rotation_matrix,
    segment_distance,
)

distance = jax.jit(segment_distance)


def pairs(n: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Vectors between the centres and half axes of n pairs of segments: near, far and crossing."""
    rng = np.random.default_rng(seed)
    between = rng.normal(size=(n, 3)) * rng.uniform(0.05, 1.5, (n, 1))
    u, v = rng.normal(size=(2, n, 3)) * rng.uniform(0.05, 1.0, (2, n, 1))
    return tuple(x.astype(np.float32) for x in (between, u, v))


def brute(between: np.ndarray, u: np.ndarray, v: np.ndarray, n: int = 401) -> np.ndarray:
    """Least distance between points sampled on two segments: too great by at most half a step."""
    s = np.linspace(-1.0, 1.0, n)
    a, b = s[:, None] * u, s[:, None] * v
    return np.linalg.norm(between + a[:, None] - b[None], axis=-1).min()


def quats(n: int, seed: int) -> np.ndarray:
    """Random unit quaternions (n, 4)."""
    quat = np.random.default_rng(seed).normal(size=(n, 4))
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def test_quaternion_product_and_matrix_equal_mujocos():
    a, b = quats(50, 0), quats(50, 1)
    product, matrix = np.zeros((50, 4)), np.zeros((50, 9))
    for i in range(50):
        mujoco.mju_mulQuat(product[i], a[i], b[i])
        mujoco.mju_quat2Mat(matrix[i], a[i])
    np.testing.assert_array_equal(quat_mul(a, b, np), product)
    np.testing.assert_allclose(rotation_matrix(a, np), matrix.reshape(50, 3, 3), atol=1e-14)
    np.testing.assert_allclose(quat_mul(jnp.asarray(a), jnp.asarray(b)), product, atol=1e-6)
    np.testing.assert_allclose(rotation_matrix(jnp.asarray(a)), rotation_matrix(a, np), atol=1e-6)


def test_rotation_takes_leading_axes_and_its_inverse_undoes_it():
    quat = quats(12, 2).reshape(3, 4, 4)
    vectors = np.random.default_rng(3).normal(size=(3, 4, 3))
    turned = rotate(quat, vectors, np)
    expected = np.einsum("abij,abj->abi", rotation_matrix(quat, np), vectors)
    np.testing.assert_allclose(turned, expected, atol=1e-14)
    np.testing.assert_allclose(rotate_inverse(quat, turned, np), vectors, atol=1e-14)


def test_rotation_matrix_normalizes_only_where_asked():
    quat = quats(1, 4)[0]
    rot = rotation_matrix(jnp.asarray(3 * quat), normalize=True)
    np.testing.assert_allclose(rot, rotation_matrix(quat, np), atol=1e-6)
    assert np.abs(rotation_matrix(3 * quat, np) - rotation_matrix(quat, np)).max() > 1.0
    entries = jax.grad(lambda q: rotation_matrix(q, normalize=True).sum())
    assert np.isfinite(entries(jnp.zeros(4))).all()


def test_axis_angle_forms_agree_and_rotation_error_recovers_the_angle():
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, 1.2
    rot = axis_angle_matrix(jnp.asarray(axis), jnp.float32(angle))
    by_quat = rotation_matrix(axis_angle_quat(axis, np.array([angle, 0.0]), np), np)
    np.testing.assert_allclose(rot, by_quat[0], atol=1e-6)
    np.testing.assert_array_equal(by_quat[1], np.eye(3))
    np.testing.assert_allclose(rotation_error(jnp.eye(3), rot), angle * axis, atol=1e-5)


def test_child_pose_is_the_product_of_both_poses():
    quat, local = quats(6, 5).astype(np.float32), quats(1, 6)[0].astype(np.float32)
    pos = np.random.default_rng(7).normal(size=(6, 3)).astype(np.float32)
    offset = (0.1, -0.2, 0.3)
    child_pos, turned = child_pose(jnp.asarray(pos), jnp.asarray(quat), offset, local)
    expected = pos + rotate(quat, np.array(offset), np)
    np.testing.assert_allclose(child_pos, expected, atol=1e-6)
    for found in (turned, child_quat(jnp.asarray(quat), local), child_quat(quat, local, np)):
        np.testing.assert_allclose(found, quat_mul(quat, local, np), atol=1e-6)


def test_segment_distance_equals_a_sampled_minimum():
    between, u, v = pairs(200)
    found = np.asarray(distance(between, u, v))
    for i, got in enumerate(found):
        step = 2 / 400 * (np.linalg.norm(u[i]) + np.linalg.norm(v[i]))
        sampled = brute(between[i], u[i], v[i])
        assert sampled - step / 2 - 1e-5 <= got <= sampled + 1e-5, i


@pytest.mark.parametrize(
    ("between", "u", "v", "expected"),
    [
        # two points; a point beside, beyond and on a segment
        ((3, 4, 0), (0, 0, 0), (0, 0, 0), 5.0),
        ((0, 2, 0.5), (0, 0, 0), (0, 0, 1), 2.0),
        ((0, 3, 5), (0, 0, 0), (0, 0, 1), 5.0),
        ((0, 0, 0.3), (0, 0, 0), (0, 0, 1), 0.0),
        ((0, 3, 5), (0, 0, 1), (0, 0, 0), 5.0),
        # parallel: side by side, overlapping in part, one behind the other, and turned round
        ((2, 0, 0), (0, 0, 1), (0, 0, 1), 2.0),
        ((2, 0, 1.5), (0, 0, 1), (0, 0, 1), 2.0),
        ((0, 0, 5), (0, 0, 1), (0, 0, 1), 3.0),
        ((3, 0, 6), (0, 0, 1), (0, 0, -1), 5.0),
        # crossing at a height, end against middle, and end against end at right angles
        ((0, 0, 0.7), (1, 0, 0), (0, 1, 0), 0.7),
        ((3, 0, 0), (1, 0, 0), (0, 1, 0), 2.0),
        ((4, 5, 0), (1, 0, 0), (0, 1, 0), 5.0),
        ((0, 0, 0), (1, 0, 0), (0, 1, 0), 0.0),
    ],
)
def test_segment_distance_of_special_cases(between: tuple, u: tuple, v: tuple, expected: float):
    args = [jnp.array(x, jnp.float32) for x in (between, u, v)]
    np.testing.assert_allclose(distance(*args), expected, atol=1e-6)
    back = [-args[0], args[2], args[1]]  # the other way round
    np.testing.assert_allclose(distance(*back), expected, atol=1e-6)


@pytest.mark.parametrize("angle", [1e-2, 1e-3, 1e-4, 1e-6])
def test_nearly_parallel_segments_are_accurate(angle: float):
    between = jnp.array([0.1, 0.0, 0.05])
    u = jnp.array([0.0, 0.0, 0.15])
    v = 0.15 * jnp.array([np.sin(angle), 0.0, np.cos(angle)], jnp.float32)
    sampled = brute(np.asarray(between), np.asarray(u), np.asarray(v), 1001)
    np.testing.assert_allclose(distance(between, u, v), sampled, atol=2e-4)


def test_segment_distance_broadcasts():
    between, u, v = pairs(6)
    grid = distance(between.reshape(2, 3, 3), u.reshape(2, 3, 3), v[0])
    assert grid.shape == (2, 3)
    np.testing.assert_allclose(grid[1, 2], distance(between[5], u[5], v[0]), atol=1e-6)


XML = """
<mujoco>
  <worldbody>
    <body mocap="true"><geom name="a" type="{a}" size="{ra} {la}"/></body>
    <body mocap="true"><geom name="b" type="{b}" size="{rb} {lb}"/></body>
  </worldbody>
</mujoco>
"""


def c_and_capsules(rng: np.random.Generator, kinds: tuple[str, str]):
    """MuJoCo's distance of two shapes somewhere, and the same two as ``capsule_gap`` takes them."""
    (ra, rb), (la, lb) = rng.uniform(0.02, 0.15, 2), rng.uniform(0.02, 0.4, 2)
    model = mujoco.MjModel.from_xml_string(
        XML.format(a=kinds[0], b=kinds[1], ra=ra, rb=rb, la=la, lb=lb)
    )
    data = mujoco.MjData(model)
    data.mocap_pos[:] = rng.uniform(-0.35, 0.35, (2, 3))
    quat = rng.normal(size=(2, 4))
    data.mocap_quat[:] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    mujoco.mj_kinematics(model, data)
    gap = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
    half = np.where([k == "capsule" for k in kinds], (la, lb), 0.0)[:, None]
    along = data.geom_xmat.reshape(2, 3, 3)[:, :, 2] * half
    shapes = [
        (data.geom_xpos[i : i + 1], along[i : i + 1], np.array([(ra, rb)[i]])) for i in (0, 1)
    ]
    return gap, *(tuple(jnp.asarray(x, jnp.float32) for x in s) for s in shapes)


@pytest.mark.parametrize(
    "kinds", [("capsule", "capsule"), ("sphere", "capsule"), ("sphere", "sphere")]
)
def test_capsule_gap_equals_mujocos(kinds: tuple[str, str]):
    rng = np.random.default_rng(1)
    gaps, ours = [], []
    for _ in range(60):
        gap, a, b = c_and_capsules(rng, kinds)
        gaps.append(gap)
        ours.append(float(capsule_gap(a, b)))
    assert min(gaps) < -0.01 < 0.01 < max(gaps)  # inside of each other, and apart
    gaps, ours = np.array(gaps), np.array(ours)
    apart = gaps > 0
    np.testing.assert_allclose(ours[apart], gaps[apart], atol=2e-5)
    # inside, C may name one of several pairs of points; both agree that it is inside
    assert (ours[~apart] < 1e-5).all()


def test_capsule_gap_is_the_minimum_over_pairs():
    a = (jnp.array([[0.0, 0, 0], [5.0, 0, 0]]), jnp.zeros((2, 3)), jnp.array([0.1, 0.2]))
    b = (jnp.array([[0.0, 1, 0], [5.0, 0, 0.5], [9.0, 9, 9]]), jnp.zeros((3, 3)), jnp.full(3, 0.05))
    np.testing.assert_allclose(capsule_gap(a, b), 0.5 - 0.2 - 0.05, atol=1e-6)
    np.testing.assert_allclose(capsule_gap(b, a), 0.5 - 0.2 - 0.05, atol=1e-6)


def test_capsule_gap_of_an_empty_set_is_infinite():
    none = (jnp.zeros((0, 3)), jnp.zeros((0, 3)), jnp.zeros(0))
    one = (jnp.zeros((1, 3)), jnp.zeros((1, 3)), jnp.ones(1))
    assert capsule_gap(none, one) == capsule_gap(one, none) == jnp.inf


def test_first_sign_is_that_of_bullets_matrix_to_quaternion():
    """btMatrix3x3::getRotation: w from a positive trace, else the part of the greatest diagonal entry."""
    quats = np.random.default_rng(5).normal(size=(400, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    found = np.asarray(first_sign(quats))
    np.testing.assert_array_equal(found, first_sign(-quats))
    np.testing.assert_array_equal(np.abs(found), np.abs(quats))
    rots = rotation_matrix(quats, np)
    positive = np.trace(rots, axis1=1, axis2=2) > 0
    assert 50 < positive.sum() < 350 and (found[positive, 0] > 0).all()
    part = 1 + np.argmax(np.diagonal(rots, axis1=1, axis2=2), axis=1)
    assert (found[np.arange(400), part][~positive] > 0).all()


def test_nearest_sign_follows_a_rotation_through_every_angle():
    angle = np.linspace(0.0, 4 * np.pi, 200)
    turning = axis_angle_quat(np.array([0.0, 0.6, 0.8]), angle, np).astype(np.float32)
    before = turning[0]
    for quat in np.asarray(first_sign(turning)):  # which jumps
        now = np.asarray(nearest_sign(quat, before))
        assert np.abs(now - before).max() < 0.04
        before = now
    np.testing.assert_allclose(before, turning[-1], atol=1e-5)
