# ruff: noqa: D103
"""The arm's pose-dependent limits: agreement with Assistive Gym's classifier, and their torque."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paths import DATA

from agym_jax.human import limits as lim

HELD_OUT = DATA / "arm_limits_heldout.npz"

# Reference humans.md section 8: degrees, probability of Assistive Gym's classifier.
RIGHT = [
    ((30, 0, 0, -90), 1.0000),
    ((5, 0, 0, 0), 0.9973),
    ((60, -60, 0, 0), 0.9999),
    ((90, 0, 0, -90), 0.9975),
    ((150, 30, 45, -120), 0.0000),
    ((30, -120, 60, -30), 0.9945),
    ((180, -180, -80, -10), 0.6552),
]
LEFT = [((-80, 0, 0, -90), 0.9996), ((-30, -60, 20, -60), 0.9480)]


@pytest.fixture(scope="module")
def limits() -> lim.ArmLimits:
    return lim.load_arm_limits()


@pytest.fixture(scope="module")
def torque(limits):
    return jax.jit(jax.vmap(lambda q, v: lim.limit_torque(limits, q, v)))


@pytest.fixture(scope="module")
def logit(limits):
    return jax.jit(lambda q: lim.reachability(limits, q))


def poses(limits: lim.ArmLimits, count: int, scale: float = 1.0, seed: int = 0) -> np.ndarray:
    """Uniform poses in the sampled box, scaled about its centre, (count, 4)."""
    u = np.random.default_rng(seed).uniform(-scale, scale, (count, 4))
    return (limits.center + u * limits.half_range).astype(np.float32)


def test_agrees_with_held_out_labels(logit):
    with np.load(HELD_OUT, allow_pickle=False) as data:
        angles, label = data["angles"], data["label"]
    assert len(label) >= 9_000
    same = np.asarray(logit(angles) > 0) == label
    assert same.mean() >= 0.99
    near = np.abs(angles[:, 1]) < 0.1
    assert same[near].mean() >= 0.97


@pytest.mark.parity
@pytest.mark.parametrize(("degrees", "probability"), RIGHT)
def test_reference_vectors_right(logit, degrees, probability):
    assert bool(logit(jnp.radians(jnp.array(degrees, jnp.float32))) > 0) == (probability > 0.5)


@pytest.mark.parity
@pytest.mark.parametrize(("degrees", "probability"), LEFT)
def test_reference_vectors_left(logit, degrees, probability):
    pose = lim.mirror_left(jnp.radians(jnp.array(degrees, jnp.float32)))
    assert bool(logit(pose) > 0) == (probability > 0.5)


def test_torque_is_zero_inside_and_bounded_outside(limits, logit, torque):
    q = poses(limits, 20_000)
    v = np.random.default_rng(1).normal(0, 2, q.shape).astype(np.float32)
    inside = np.asarray(logit(q) > 0)
    tau = np.asarray(torque(q, v))
    norm = np.linalg.norm(tau, axis=-1)
    assert (tau[inside] == 0).all()
    assert norm.max() <= lim.MAX_TORQUE * 1.0001
    assert np.median(norm[~inside]) > 2.0


def test_torque_points_back(limits, logit, torque):
    q = poses(limits, 20_000, seed=2)
    q = q[np.abs(q[:, 1]) > 4 * lim.WRAP_WIDTH]
    tau = np.asarray(torque(q, np.zeros_like(q)))
    norm = np.linalg.norm(tau, axis=-1, keepdims=True)
    pushed = norm[:, 0] > 0.05
    step = 2e-3 * tau / np.maximum(norm, 1e-9)
    gain = np.asarray(logit(q + step) - logit(q))[pushed]
    assert (gain > 0).mean() > 0.999


def test_torque_opposes_outward_motion_only(limits, torque):
    q = poses(limits, 5_000, seed=3)
    still = np.asarray(torque(q, np.zeros_like(q)))
    norm = np.linalg.norm(still, axis=-1, keepdims=True)
    inward = still / np.maximum(norm, 1e-9)
    back, out = np.asarray(torque(q, inward)), np.asarray(torque(q, -inward))
    np.testing.assert_allclose(back, still, atol=1e-5)
    assert (np.linalg.norm(out, axis=-1) >= norm[:, 0] - 1e-5).all()
    rest = (norm[:, 0] > 0.5) & (norm[:, 0] < 5.0)
    assert (np.linalg.norm(out, axis=-1) > norm[:, 0] + 0.02)[
        rest
    ].mean() > 0.85  # the others lie where the slope is flat


def test_finite_everywhere(limits, logit, torque):
    q = poses(limits, 100_000, scale=3.0, seed=4)
    v = np.random.default_rng(5).normal(0, 20, q.shape).astype(np.float32)
    assert np.isfinite(logit(q)).all()
    assert np.isfinite(torque(q, v)).all()
    extreme = np.array([[1e6] * 4, [-1e6] * 4, [0.0] * 4, [1e30] * 4], np.float32)
    assert np.isfinite(torque(extreme, extreme)).all()


def test_derivatives_are_finite(limits):
    q = jnp.asarray(poses(limits, 2_000, scale=1.5, seed=6))
    slope = jax.vmap(jax.jacfwd(lambda x: lim.limit_torque(limits, x, jnp.zeros(4))))(q)
    assert np.isfinite(slope).all()


def test_left_mirrors_right(limits):
    sign = np.array([-1, 1, -1, 1], np.float32)
    q = jnp.asarray(poses(limits, 500, seed=7))
    v = jnp.asarray(np.random.default_rng(8).normal(0, 1, q.shape).astype(np.float32))
    right = jax.vmap(lambda q, v: lim.limit_torque(limits, q, v))(q, v)
    left = jax.vmap(lambda q, v: lim.limit_torque(limits, q, v, -1.0))(q * sign, v * sign)
    np.testing.assert_allclose(left, right * sign, atol=1e-6)
    assert np.abs(right).max() > 1.0


def test_torque_is_smooth(limits, torque):
    rng = np.random.default_rng(9)
    q = poses(limits, 20_000, scale=1.1, seed=10)
    step = rng.normal(size=q.shape).astype(np.float32)
    step *= 1e-3 / np.linalg.norm(step, axis=-1, keepdims=True)
    zero = np.zeros_like(q)
    change = np.linalg.norm(np.asarray(torque(q + step, zero) - torque(q, zero)), axis=-1)
    slope = change / 1e-3
    print(f"slope [N m/rad]: median {np.median(slope):.1f}, max {slope.max():.0f}")
    assert np.percentile(slope, 99) < 10 * lim.STIFFNESS
    assert change.max() < 0.3 * lim.MAX_TORQUE  # no jump over a twentieth of a degree


def push_out(limits, start, direction, inertia, damping, seconds=20.0, step=0.02):
    """Angles (steps, n, 4) of arms pushed with 1 N m: explicit torque, implicit joint damping."""

    def advance(state, _):
        q, v = state
        tau = jax.vmap(lambda q, v: lim.limit_torque(limits, q, v))(q, v) + direction
        v = (inertia * v + step * tau) / (inertia + step * damping)
        q = q + step * v
        low, high = limits.center - limits.half_range, limits.center + limits.half_range
        stopped = jnp.clip(q, low, high)
        v = jnp.where(stopped == q, v, 0.0)
        return (stopped, v), (stopped, v)

    state = (jnp.asarray(start), jnp.zeros_like(start))
    return jax.lax.scan(advance, state, length=int(seconds / step))[1]


@pytest.mark.parametrize(
    ("inertia", "damping"), [(0.02, 1.0), (0.02, 10.0), (0.3, 1.0), (0.05, 0.4)]
)
def test_pushed_arm_rests_at_the_boundary(limits, logit, torque, inertia, damping):
    q = poses(limits, 4_000, seed=11)
    q = q[np.asarray(logit(q)) > 0][:400]
    rng = np.random.default_rng(12)
    direction = rng.normal(size=q.shape).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    run = jax.jit(lambda q: push_out(limits, q, direction, inertia, damping))
    path, velocity = (np.asarray(x) for x in run(q))
    distance = np.asarray(jax.vmap(lambda q: lim._inward(limits, q)[0])(path[-1]))
    drift = np.linalg.norm(path[-1] - path[-101], axis=-1) / 2.0
    speed = np.linalg.norm(velocity[-100:], axis=-1).mean(0)
    print(
        f"inertia {inertia} damping {damping}, [50, 95, 100] %: outside"
        f" {np.percentile(distance, [50, 95, 100])} rad, drift"
        f" {np.percentile(drift, [50, 95, 100])} rad/s, speed"
        f" {np.percentile(speed, [50, 95, 100])} rad/s"
    )
    assert np.isfinite(path).all()
    assert np.percentile(distance, 95) < 0.1
    assert distance.max() < 0.3
    # Some slide along the boundary for long, most stand still.
    assert np.percentile(drift, 95) < 0.15
    assert np.percentile(speed, 90) < 0.2
