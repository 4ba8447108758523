# ruff: noqa: D103
"""Particles against closed forms: falling, resting, sliding, colliding; masks, contacts, non-finite values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.matter.particles.constraints import LAST_RELAXATION, apply_pairs, apply_vessel
from agym_jax.matter.particles.containers import CUP, SPOON
from agym_jax.matter.particles.solver import (
    Contact,
    Obstacles,
    Particles,
    ParticleSpec,
    advance,
    step,
)
from agym_jax.matter.shapes import Boxes, Capsules, columns

DT, STEPS, NUM_ENVS, R, MU, G = 0.002, 200, 8, 0.005, 0.3, 9.81
SPEC = ParticleSpec(CUP, count=3, radius=R, friction=MU, damping=0.0, substeps=1, sweeps=2)
DAMPING = 0.5
FREE = replace(SPEC, count=6, gravity=0.0, damping=DAMPING)
TIME = DT * STEPS
SLOWER = (1.0 - DAMPING * DT) ** STEPS
FAR = 20.0


def scene(**changes: Any) -> dict[str, np.ndarray]:
    """A scene in which all obstacles are far away and at rest."""
    far = {
        "vessel": np.array([0, 0, -1.0]), "turn": np.array([1.0, 0, 0, 0]), "a": np.array([[-FAR, 0, 0]]),
        "b": np.array([[-FAR, 0, 1]]), "radius": np.array([0.04]), "box": np.array([[0, FAR, 0]]),
        "tilt": np.array([[1.0, 0, 0, 0]]), "half": np.array([[1.0, 1.0, 0.5]]), "floor": np.array(-FAR),
    }  # fmt: skip
    assert set(changes) <= set(far)
    return {k: np.asarray(v, np.float32) for k, v in (far | changes).items()}


def obstacles(batch: list[dict[str, np.ndarray]], speed: Any = 0.0) -> Obstacles:
    """A batch of scenes over STEPS physics steps; capsules move with a velocity [m/s]."""
    x = {k: jnp.stack([jnp.asarray(w[k]) for w in batch]) for k in batch[0]}
    moments = jnp.arange(STEPS + 1)[None, :, None]
    constant = lambda v: jnp.broadcast_to(v[:, None], (len(batch), STEPS + 1, *v.shape[1:]))  # noqa: E731
    away = (moments * DT * jnp.asarray(speed, jnp.float32))[:, :, None, :]
    return Obstacles(
        vessel_pos_w=constant(x["vessel"]),
        vessel_quat_w=constant(x["turn"]),
        human=Capsules(constant(x["a"]) + away, constant(x["b"]) + away, x["radius"]),
        furniture=Boxes(x["box"], x["tilt"], x["half"]),
        floor=x["floor"],
    )


def particles(pos: Any, vel: Any = 0.0, alive: Any = True) -> Particles:
    """The same particles in each environment (NUM_ENVS, n, 3)."""
    pos = np.broadcast_to(np.asarray(pos, np.float32), (NUM_ENVS, *np.shape(pos)[-2:]))
    return Particles(
        jnp.asarray(pos),
        jnp.asarray(np.broadcast_to(np.asarray(vel, np.float32), pos.shape)),
        jnp.asarray(np.broadcast_to(alive, pos.shape[:2])),
    )


@pytest.fixture(scope="module")
def run() -> Any:
    """0.4 s of eight environments of three particles."""
    return jax.jit(jax.vmap(lambda p, m: advance(SPEC, p, m, DT)))


@pytest.fixture(scope="module")
def drift() -> Any:
    """0.4 s of eight environments of six particles without gravity."""
    return jax.jit(jax.vmap(lambda p, m: advance(FREE, p, m, DT)))


HIGH = np.array([[0.0, 0, 6.0], [0.3, 0, 6.0], [0.6, 0, 6.0]])
APART = np.array([[0.0, 0, 1.0], [0.3, 0, 1.0], [0.6, 0, 1.0]])


def test_free_fall_matches_closed_form(run: Any) -> None:
    vel = np.array([[1.0, 0.5, 2.0], [0, 0, 0], [-2.0, 0, 1.0]])
    after, contact = run(particles(HIGH, vel), obstacles([scene()] * NUM_ENVS))
    expected = HIGH + vel * TIME - [0, 0, G * TIME**2 / 2]
    np.testing.assert_allclose(after.pos_w[3], expected, atol=G * TIME * DT / 2 + 1e-4)
    np.testing.assert_allclose(after.vel_w[3], vel - [0, 0, G * TIME], atol=5e-3)
    for touched in (contact.vessel, contact.human, contact.furniture, contact.floor):
        assert not np.any(touched)


def test_damping_and_max_speed_match_closed_form(drift: Any) -> None:
    pos = np.arange(6.0)[:, None] * [0, 1.0, 0]
    vel = np.zeros((6, 3))
    vel[:2, 0] = 1.0, 10.0
    after, _ = drift(particles(pos, vel), obstacles([scene()] * NUM_ENVS))
    assert after.vel_w[0, 0, 0] == pytest.approx(np.exp(-DAMPING * TIME), abs=1e-3)
    path = 6.0 * (1 - np.exp(-DAMPING * TIME)) / DAMPING
    assert after.pos_w[0, 1, 0] == pytest.approx(path, rel=1e-3)


def test_resting_particles_neither_creep_nor_sink(run: Any) -> None:
    """Ten times 0.4 s."""
    state, motion = particles(APART * [1, 1, R]), obstacles([scene(floor=0.0)] * NUM_ENVS)
    for _ in range(10):
        state, contact = run(state, motion)
    np.testing.assert_allclose(state.pos_w[0], APART * [1, 1, R], atol=2e-5)
    np.testing.assert_allclose(state.vel_w[0], 0.0, atol=1e-3)
    assert np.all(contact.floor)
    assert not np.any(contact.furniture | contact.human | contact.vessel)


def test_particles_stick_and_slide_on_slopes_by_coulombs_law(run: Any) -> None:
    """Below atan(friction) particles stay; above they have Coulomb's acceleration."""
    angle = np.deg2rad([0.0, 8.0, 15.0, 16.5, 17.5, 22.0, 30.0, 45.0])
    normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    turns = np.stack([np.cos(angle / 2), 0 * angle, np.sin(angle / 2), 0 * angle], -1)
    slopes = [scene(box=[-0.5 * n], tilt=[q]) for n, q in zip(normal, turns, strict=True)]
    along = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], -1)
    places = np.array([-0.2, 0.0, 0.2])
    start = R * normal[:, None] + places[:, None] * along[:, None]
    after, contact = run(particles(start), obstacles(slopes))
    moved = np.asarray(after.pos_w) - start
    down = np.einsum("wni,wi->wn", moved, along)
    expected = np.maximum(np.sin(angle) - MU * np.cos(angle), 0.0) * G * TIME**2 / 2
    np.testing.assert_allclose(down, np.repeat(expected[:, None], 3, 1), rtol=0.02, atol=1e-4)
    off = np.einsum("wni,wi->wn", moved, normal)
    np.testing.assert_allclose(off, 0.0, atol=1e-4)
    assert np.all(contact.furniture)
    assert not np.any(contact.floor)


def test_sliding_distance_follows_from_friction(run: Any) -> None:
    vel = np.array([[0, 0.5, 0], [0, 1.0, 0], [0, -2.0, 0]])
    floor = obstacles([scene(floor=0.0)] * NUM_ENVS)
    after, _ = run(particles(APART * [1, 1, R], vel), floor)
    speed = np.linalg.norm(vel, axis=1)
    time = np.minimum(speed / (MU * G), TIME)
    path = speed * time - MU * G * time**2 / 2
    gone = np.linalg.norm(np.asarray(after.pos_w[0]) - APART * [1, 1, R], axis=1)
    np.testing.assert_allclose(gone, path, rtol=0.02)


def test_moving_arm_carries_particles(run: Any) -> None:
    """Friction acts on the relative motion: a particle is at rest relative to a slow conveyor."""
    belt = scene(a=[[0.0, -1.0, 0.0]], b=[[0.0, 1.0, 0.0]], radius=[0.2])
    start = np.array([[0.0, 0.0, 0.2 + R], [0.0, 0.3, 0.2 + R], [0.0, -0.3, 0.2 + R]])
    after, contact = run(particles(start, [0, 0.2, 0]), obstacles([belt] * NUM_ENVS, [0, 0.2, 0]))
    np.testing.assert_allclose(after.pos_w[0], start + np.array([0, 0.2 * TIME, 0]), atol=3e-4)
    assert np.all(contact.human)


def momentum(state: Particles) -> np.ndarray:
    return np.asarray(state.vel_w).sum(1)


def test_collision_of_two_particles_conserves_momentum_without_bouncing(drift: Any) -> None:
    """Kinetic energy decreases."""
    offset = np.linspace(0.0, 0.009, NUM_ENVS)
    pos = np.tile(np.arange(6.0)[:, None] * [0, 0, 1.0], (NUM_ENVS, 1, 1))
    vel = np.zeros_like(pos)
    pos[:, 0], vel[:, 0] = np.stack([-0.05 + 0 * offset, offset, 0 * offset], -1), [1.0, 0, 0]
    pos[:, 1], vel[:, 1] = [0.05, 0, 0], [-0.5, 0, 0]
    before = particles(pos, vel)
    after, contact = drift(before, obstacles([scene()] * NUM_ENVS))
    np.testing.assert_allclose(momentum(after), SLOWER * momentum(before), atol=2e-4)
    approach = np.asarray(after.vel_w[0, 1] - after.vel_w[0, 0])
    assert -0.01 < approach[0] < 0.06  # head on: they came at 1.5 m/s
    energy = lambda s: np.sum(np.square(s.vel_w), axis=(1, 2))  # noqa: E731
    assert (energy(after) < energy(before)).all()
    # head on they share their momentum; at the edge they glance off
    np.testing.assert_allclose(energy(after)[0], SLOWER**2 * 2 * 0.25**2, rtol=0.02)
    assert energy(after)[-1] > 0.5
    assert not np.any(contact.vessel)


def test_collisions_of_many_particles_conserve_momentum(drift: Any) -> None:
    rng = np.random.default_rng(0)
    ring = 0.03 * np.stack([np.cos(np.arange(6)), np.sin(np.arange(6)), 0 * np.arange(6)], -1)
    pos = ring + rng.normal(0, 0.002, (NUM_ENVS, 6, 3))
    vel = -20 * ring + rng.normal(0, 0.1, (NUM_ENVS, 6, 3))
    before = particles(pos, vel)
    after, _ = drift(before, obstacles([scene()] * NUM_ENVS))
    left = np.linalg.norm(after.vel_w, axis=-1).mean() / np.linalg.norm(vel, axis=-1).mean()
    assert left < 0.8 * SLOWER  # they did collide
    np.testing.assert_allclose(momentum(after), SLOWER * momentum(before), atol=3e-4)


@pytest.mark.parametrize("what", ["floor", "box", "arm"])
def test_no_solid_is_crossed_at_max_speed(run: Any, what: str) -> None:
    """At up to 6 m/s, the maximum speed, against solids of 40 mm half thickness."""
    where = {
        "floor": scene(floor=0.8),
        "box": scene(box=[[0.3, 0, 0.76]], half=[[1.0, 1.0, 0.04]]),
        "arm": scene(a=[[-1.0, 0, 0.76]], b=[[1.0, 0, 0.76]], radius=[0.04]),
    }[what]
    vel = np.linspace(-6.0, -1.0, NUM_ENVS)[:, None, None] * [0.0, 0, 1.0]
    after, contact = run(
        particles(np.tile(APART, (NUM_ENVS, 1, 1)), vel), obstacles([where] * NUM_ENVS)
    )
    assert (np.asarray(after.pos_w)[..., 2] > 0.8 + R - 1e-4).all()
    touched = {"floor": contact.floor, "box": contact.furniture, "arm": contact.human}
    for name, who in touched.items():
        assert np.all(who) if name == what else not np.any(who)


def test_sweeping_arm_pushes_particles(run: Any) -> None:
    """At 2 m/s, sideways: no particle passes through it."""
    arm = scene(a=[[-0.05, -1, 1]], b=[[-0.05, 1, 1]])
    hit = np.array([[0.0, 0, 1.0], [0.0, 0.1, 1.0], [0.0, -0.2, 0.9]])
    after, contact = run(particles(hit, [0, 0, 1.0]), obstacles([arm] * NUM_ENVS, [2.0, 0, 0]))
    past = np.asarray(after.pos_w[0, :2, 0])
    assert (past > 0.05).all()
    assert np.asarray(after.pos_w)[0, 2, 0] == 0.0 and not np.any(contact.human[:, 2])


def test_contacts_are_those_of_the_last_physics_step() -> None:
    """As AG reads them: what was touched before, and then left, does not count."""
    spec = replace(SPEC, substeps=3)
    belt = scene(a=[[-1.0, 0, 0.9]], b=[[1.0, 0, 0.9]], radius=[0.1])
    start = jax.tree.map(lambda x: x[0], particles(APART + np.array([0, 0, R])))
    still = jax.tree.map(lambda x: x[0], obstacles([belt], 0.0))

    @jax.jit
    def touched(sunk: jax.Array) -> jax.Array:
        """Whom the belt touches, if it has sunk so far [m] at each of four moments."""
        down = -sunk[:, None, None] * jnp.array([0.0, 0.0, 1.0])
        a_w, b_w = still.human.a_w[:4] + down, still.human.b_w[:4] + down
        motion = replace(
            still, human=replace(still.human, a_w=a_w, b_w=b_w),
            vessel_pos_w=still.vessel_pos_w[:4], vessel_quat_w=still.vessel_quat_w[:4],
        )  # fmt: skip
        return advance(spec, start, motion, DT)[1].human

    assert np.all(touched(jnp.zeros(4)))
    assert not np.any(touched(jnp.array([0.0, 0.0, 0.01, 0.02])))
    assert np.all(touched(jnp.array([0.01, 0.005, 0.005, -1e-3])))  # it comes only then


def test_masked_particles_neither_move_nor_collide(run: Any) -> None:
    pos = np.array([[0.0, 0, 0.1], [0.0, 0, R], [0.3, 0, 0.1]])
    alive = np.array([True, False, False])
    floor = obstacles([scene(floor=0.0)] * NUM_ENVS)
    after, contact = run(particles(pos, alive=alive), floor)
    assert after.pos_w[0, 0, 2] == pytest.approx(R, abs=1e-4)  # fell through the masked one
    np.testing.assert_array_equal(after.pos_w[:, 1:], particles(pos).pos_w[:, 1:])
    np.testing.assert_array_equal(after.vel_w[:, 1:], 0.0)
    np.testing.assert_array_equal(after.alive[0], alive)
    np.testing.assert_array_equal(contact.floor[0], alive)
    assert int(contact.lost.sum()) == 0


def test_removed_particles_are_masked() -> None:
    state = jax.tree.map(lambda x: x[0], particles(APART)).remove(jnp.array([False, True, False]))
    np.testing.assert_array_equal(state.alive, [True, False, True])
    np.testing.assert_array_equal(
        state.remove(jnp.array([True, True, False])).alive, [False, False, True]
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["pos_w", "vel_w"])
def test_non_finite_particle_is_masked_and_counted(run: Any, field: str, bad: float) -> None:
    whole = particles(HIGH)
    broken = replace(whole, **{field: getattr(whole, field).at[2, 1, 0].set(bad)})
    motion = obstacles([scene(floor=0.0)] * NUM_ENVS)
    after, contact = run(broken, motion)
    expected, _ = run(whole, motion)
    np.testing.assert_array_equal(contact.lost, np.eye(NUM_ENVS, dtype=int)[2])
    np.testing.assert_array_equal(after.alive[2], [True, False, True])
    assert np.isfinite(after.pos_w).all() and np.isfinite(after.vel_w).all()
    others = np.ones((NUM_ENVS, 3), bool)
    others[2, 1] = False
    np.testing.assert_array_equal(
        np.asarray(after.pos_w)[others], np.asarray(expected.pos_w)[others]
    )
    again, contact = run(after, motion)
    assert int(contact.lost.sum()) == 0  # counted once
    np.testing.assert_array_equal(again.alive, after.alive)


def test_non_finite_vessel_loses_its_particles(run: Any) -> None:
    motion = obstacles([scene(vessel=[0, 0, 0])] * NUM_ENVS)
    motion = replace(motion, vessel_pos_w=motion.vessel_pos_w.at[5, 7].set(jnp.nan))
    after, contact = run(particles(APART), motion)
    np.testing.assert_array_equal(contact.lost, 3 * np.eye(NUM_ENVS, dtype=int)[5])
    assert np.isfinite(after.pos_w).all() and np.isfinite(after.vel_w).all()


def test_single_steps_equal_a_batched_trajectory(run: Any) -> None:
    """One environment, moved by ``step``, where an arm comes from below; all in float32."""
    arm = scene(floor=0.9, a=[[0, -1, 0.9]], b=[[0, 1, 0.9]])
    state, motion = particles(APART), obstacles([arm] * NUM_ENVS, [0, 0, 0.2])
    together, contact = run(state, motion)
    one, motion = jax.tree.map(lambda x: x[4], (state, motion))

    def moment(i: jax.Array) -> Obstacles:
        human = replace(motion.human, a_w=motion.human.a_w[i], b_w=motion.human.b_w[i])
        pos, quat = motion.vessel_pos_w[i], motion.vessel_quat_w[i]
        return replace(motion, vessel_pos_w=pos, vessel_quat_w=quat, human=human)

    @jax.jit
    def alone(state: Particles) -> tuple[Particles, Contact]:
        def go(state: Particles, i: jax.Array) -> tuple[Particles, Contact]:
            return step(SPEC, state, moment(i), moment(i + 1), DT)

        return jax.lax.scan(go, state, jnp.arange(STEPS))

    after, each = alone(one)
    np.testing.assert_allclose(after.pos_w, together.pos_w[4], atol=2e-6)
    np.testing.assert_array_equal(each.human[-1], contact.human[4])
    np.testing.assert_array_equal(each.human.any(0), [True, False, False])
    np.testing.assert_array_equal(contact.floor[4], [False, True, True])
    assert after.pos_w.dtype == after.vel_w.dtype == jnp.float32
    assert each.lost.dtype == jnp.int32


def test_results_are_reproducible_bit_for_bit(run: Any) -> None:
    """For a heap of particles, in two runs and at any index of the batch."""
    rng = np.random.default_rng(1)
    heap = np.repeat(0.01 * rng.normal(size=(1, 3, 3)) + [0, 0, 0.02], NUM_ENVS, axis=0)
    motion = obstacles([scene(floor=0.0)] * NUM_ENVS)
    first, second = run(particles(heap), motion), run(particles(heap), motion)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, np.repeat(np.asarray(a)[:1], NUM_ENVS, axis=0))


def test_gradients_at_coincident_points_are_finite() -> None:
    """Of particles in one place, on the cup's axis, in the middle of its wall."""
    pos = jnp.array(
        [[0.0, 0, 0.01], [0.0, 0, 0.01], [CUP.brim[0], 0, CUP.brim[1]], [0.0, 0, 0.0044]]
    )

    def total(pos: jax.Array) -> jax.Array:
        local, old = columns(pos), columns(pos + 1e-4)
        local, contacts = apply_pairs(R, MU, local, old, jnp.zeros(4), LAST_RELAXATION, DT)
        local, _ = apply_vessel(CUP, R, MU, local, old, DT)
        return sum(jnp.sum(x) for x in local) + jnp.sum(contacts)

    assert np.isfinite(jax.jit(jax.grad(total))(pos)).all()


def test_no_displacement_passes_the_wall() -> None:
    """Displacements of up to 30 mm in a substep of 2 ms (15 m/s) change sides through the opening only."""
    rng = np.random.default_rng(2)
    for vessel in (CUP, SPOON):
        size = np.array([vessel.brim[0], vessel.brim[0] + vessel.trough, vessel.rim_height])
        start = rng.uniform(-1.4, 1.4, (20_000, 3)) * size * [1, 1, 0.6] + [0, 0, size[2] / 2]
        way = rng.normal(size=start.shape)
        way *= rng.uniform(0, 0.03, (len(way), 1)) / np.linalg.norm(way, axis=1, keepdims=True)
        old, new = columns(jnp.asarray(start)), columns(jnp.asarray(start + way))
        clear = np.asarray(vessel.wall(*old)[0]) > R + vessel.thickness / 2
        inside = np.asarray(vessel.holds(*old))
        opening = np.asarray(vessel.passes(old, new))
        crossed = clear & (inside != np.asarray(vessel.holds(*new))) & ~opening
        assert crossed.sum() > 300  # of these ways
        local, touched = new, jnp.zeros(len(start), bool)
        for _ in range(2):
            local, now = apply_vessel(vessel, R, MU, local, old, 0.002)
            touched = touched | now
        over = np.asarray(local[2]) > vessel.brim[1]  # a shallow bowl's particles stand out of it
        over &= np.asarray(vessel.polar(*local[:2])[0]) < vessel.brim[0]
        kept = np.where(
            inside, over | np.asarray(vessel.holds(*local)), ~np.asarray(vessel.holds(*local))
        )
        assert np.asarray(touched)[crossed].all()
        assert kept[crossed].all(), vessel
        distance = np.asarray(vessel.wall(*local)[0]) - R - vessel.thickness / 2
        assert distance[crossed].min() > -0.5 * R
