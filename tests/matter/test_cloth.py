# ruff: noqa: D103
"""Cloth against mechanics: a catenary, weights and friction in newtons, energy, momentum."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scene import DT, NOTHING, sheet
from scipy.optimize import brentq

from agym_jax.matter.cloth.garment import load
from agym_jax.matter.cloth.solver import (
    GATHER_RATE,
    SLIP_RATE,
    SLIP_STRETCH,
    Cloth,
    ClothContact,
    anchor_positions,
    initial,
    slip,
    step,
)  # fmt: skip
from agym_jax.matter.cloth.topology import GOWN_FABRIC, ClothSpec, Fabric, build_cloth
from agym_jax.matter.shapes import Capsules

G = 9.81


def loose(spec: ClothSpec) -> ClothSpec:
    """The same cloth without anchors."""
    return replace(spec, held=np.full(spec.count, -1), reach=np.full(spec.count, 1e3))


def run(spec, cloth, n, solids=NOTHING, anchors=None, speed=(0.0, 0.0, 0.0)):
    """All states and contacts of n physics steps, while the anchors move at a speed [m/s]."""
    held = anchor_positions(spec, jnp.zeros(3)) if anchors is None else jnp.asarray(anchors)
    way = jnp.asarray(speed) * DT

    def one(cloth, i):
        ends = held + i * way, held + (i + 1) * way
        cloth, touch = step(spec, cloth, solids, solids, *ends, DT)
        return cloth, (cloth, touch)

    return jax.device_get(jax.jit(lambda c: jax.lax.scan(one, c, jnp.arange(n))[1])(cloth))


def strains(spec: ClothSpec, pos: np.ndarray, compliance: float) -> np.ndarray:
    """Strains of the edges of one compliance."""
    edges = spec.edges
    rows, ids = np.nonzero((edges.active > 0) & (edges.compliance == compliance))
    lengths = np.linalg.norm(pos[edges.partner[rows, ids]] - pos[ids], axis=-1)
    return lengths / edges.rest[rows, ids] - 1.0


def table(radius: float = 0.3) -> Capsules:
    """A capsule along x so thick that its top, at z = 0, is nearly level."""
    ends = jnp.array([[-2.0, 0.0, -radius]]), jnp.array([[2.0, 0.0, -radius]])
    return Capsules(*ends, jnp.array([radius]))


def lying(spec: ClothSpec, height: float) -> Cloth:
    """A level sheet over the table, its height [m] along y."""
    v = spec.garment.vertices
    pos = np.stack([v[:, 0], v[:, 2] - v[:, 2].mean(), np.full(len(v), height)], -1)
    return Cloth(jnp.asarray(pos, jnp.float32), jnp.zeros((len(v), 3)))


def test_hanging_strip_is_a_catenary():
    wide, apart = 1.0, 0.8
    spec = build_cloth(sheet(wide, 0.05, 0.025, "ends"), Fabric(damping=4.0))
    v = spec.garment.vertices
    squeezed = v * [apart / wide, 1.0, 1.0]
    sag = 0.25 * (1.0 - (2.0 * v[:, 0] / wide - 1.0) ** 2)
    flat = squeezed - np.stack([0 * sag, v[:, 2], v[:, 2] + sag], -1)  # horizontal along y, sagging
    start = Cloth(jnp.asarray(flat, jnp.float32), jnp.zeros_like(jnp.asarray(flat, jnp.float32)))
    states, _ = run(spec, start, 600, anchors=flat[spec.garment.anchors].astype(np.float32))
    pos = states.pos_w[-1]
    a = brentq(lambda a: 2 * a * np.sinh(apart / 2 / a) - wide, 0.1, 10.0)
    x = pos[:, 0] - apart / 2
    expected = a * (np.cosh(x / a) - np.cosh(apart / 2 / a))
    assert abs(expected.min() - pos[:, 2].min()) < 0.015  # of 0.265 m: 0.7 % longer
    assert np.abs(expected - pos[:, 2]).max() < 0.02


def test_hanging_sheet_stretches_by_less_than_3_percent():
    spec = build_cloth(sheet(0.3, 0.6, 0.025))
    states, _ = run(spec, initial(spec, jnp.zeros(3)), 100)
    assert -states.pos_w[-1][:, 2].min() < 1.03 * 0.6
    soft = build_cloth(sheet(0.3, 0.6, 0.025), Fabric(stretch=0.1, shear=0.1))
    soft = replace(soft, reach=np.full(soft.count, 1e3))  # and without tethers
    assert -run(soft, initial(soft, jnp.zeros(3)), 60)[0].pos_w[-1][:, 2].min() > 1.05 * 0.6


def test_a_sheet_that_may_give_is_longer_by_no_more_than_that():
    weak = build_cloth(sheet(0.3, 0.6, 0.025), Fabric(stretch=0.1, shear=0.1, give=1.2))
    longest = -run(weak, initial(weak, jnp.zeros(3)), 60)[0].pos_w[:, :, 2].min()
    assert 1.05 * 0.6 < longest < 1.23 * 0.6


def test_gown_hangs_nearly_unstretched():
    spec = build_cloth(load(), GOWN_FABRIC)
    threads = strains(spec, spec.garment.hanging, spec.fabric.stretch)
    assert threads.mean() < 0.02 and np.quantile(threads, 0.9) < 0.05  # AG: 0.02 to 0.11
    states, touch = run(spec, initial(spec, jnp.zeros(3)), 50)
    cuff = spec.garment.cuff  # the wide end closes as soon as there is no hand in it
    assert np.abs(states.pos_w[-1] - spec.garment.hanging)[cuff].max() < 0.1
    assert not touch.broken.any()


def test_contact_force_of_resting_cloth_equals_its_weight():
    spec = loose(build_cloth(sheet(0.3, 0.2, 0.025)))
    _, touch = run(spec, lying(spec, 0.009), 150, table())
    weight = spec.mass.sum() * G
    felt = touch.net_w[-50:].mean(0)[0]
    np.testing.assert_allclose(felt[2], -weight, rtol=0.05)
    assert np.abs(felt[:2]).max() < 0.05 * weight
    assert weight * 0.95 < touch.total[-50:].mean() < 1.3 * weight


@pytest.mark.parametrize(("friction", "density"), [(0.1, 0.2), (0.3, 0.2), (0.3, 0.4)])
def test_friction_force_is_coefficient_times_weight(friction: float, density: float):
    garment = replace(sheet(0.3, 0.2, 0.025), area_density=density)
    garment = replace(garment, anchors=np.flatnonzero(garment.vertices[:, 0] > 0.299))
    spec = build_cloth(garment, Fabric(friction=friction))
    start = lying(spec, 0.008)
    _, touch = run(spec, start, 200, table(), np.asarray(start.pos_w)[garment.anchors], (0.1, 0, 0))
    felt = touch.net_w[-100:].mean(0)[0]
    free = spec.mass[spec.held < 0].sum() * G
    assert 0.8 * free < -felt[2] < 1.2 * free
    np.testing.assert_allclose(felt[0] / -felt[2], friction, rtol=0.15)


def test_grip_force_balances_weight_and_friction():
    spec = build_cloth(sheet(0.3, 0.4, 0.025))
    states, touch = run(spec, initial(spec, jnp.zeros(3)), 300)
    weight = spec.mass[spec.held < 0].sum() * G
    np.testing.assert_allclose(touch.grip_w[-100:].mean(0), [0.0, 0.0, weight], atol=0.02 * weight)
    edges = spec.edges
    rows, ids = np.nonzero(edges.active > 0)
    long = np.linalg.norm(
        states.pos_w[-1][edges.partner[rows, ids]] - states.pos_w[-1][ids], axis=-1
    )
    np.testing.assert_allclose(touch.stretch[-1], (long / edges.rest[rows, ids]).max(), rtol=1e-4)
    garment = sheet(0.3, 0.2, 0.025)
    garment = replace(garment, anchors=np.flatnonzero(garment.vertices[:, 0] > 0.299))
    spec = build_cloth(garment, Fabric(friction=0.3))
    start = lying(spec, 0.008)
    _, touch = run(spec, start, 200, table(), np.asarray(start.pos_w)[garment.anchors], (0.1, 0, 0))
    np.testing.assert_allclose(
        touch.grip_w[-100:, 0].mean(), touch.net_w[-100:, 0, 0].mean(), rtol=0.05
    )


def test_cloth_slips_in_proportion_to_its_stretch():
    def after(slid, stretch, grip):
        nothing = jnp.zeros((0, 3)), jnp.zeros(0)
        felt = ClothContact(*nothing, jnp.array(grip), jnp.float32(stretch), jnp.array(False))
        return slip(jnp.array(slid), felt, DT)

    up = (0.0, 0.0, 2.0)  # the hand pulls upwards, so the cloth slides downwards
    np.testing.assert_allclose(
        after((0.0, 0.0, 0.0), SLIP_STRETCH + 0.1, up), [0, 0, -SLIP_RATE * 0.1 * DT], rtol=1e-4
    )
    np.testing.assert_allclose(after((0.0, 0.0, 0.0), 1.2, up), 0.0, atol=1e-9)
    back = 0.1 - GATHER_RATE * (SLIP_STRETCH - 1.3) * DT
    np.testing.assert_allclose(after((0.1, 0.0, 0.0), 1.3, up), [back, 0.0, 0.0], rtol=1e-4)
    np.testing.assert_allclose(after((1e-4, 0.0, 0.0), 1.0, up), 0.0, atol=1e-9)
    assert np.isfinite(after((0.0, 0.0, 0.0), 9.0, (0.0, 0.0, 0.0))).all()


def test_released_cloth_falls_freely():
    spec = build_cloth(load())
    cloth, none = initial(spec, jnp.zeros(3)), NOTHING
    at = anchor_positions(spec, jnp.zeros(3))
    still, held, gone = (
        jax.jit(lambda c, h: step(spec, c, none, none, at, at, DT, h)[0])(cloth, h)
        for h in (None, jnp.bool_(True), jnp.bool_(False))
    )
    np.testing.assert_allclose(held.pos_w, still.pos_w, atol=1e-6)
    np.testing.assert_allclose(held.pos_w[spec.garment.anchors], at, atol=1e-6)
    momentum = spec.mass @ np.asarray(gone.vel_w) / spec.mass.sum()
    np.testing.assert_allclose(momentum, [0.0, 0.0, -G * DT], atol=0.01 * G * DT)


def test_cloth_rests_on_the_floor():
    spec, floor = build_cloth(load()), -0.3
    at, far = anchor_positions(spec, jnp.zeros(3)), table()
    far = replace(far, a_w=far.a_w + 9.0, b_w=far.b_w + 9.0)
    start = initial(spec, jnp.array([0.0, 0.0, 0.6]))
    start = replace(start, vel_w=jnp.full((spec.count, 3), 0.5))

    @jax.jit
    def fall(cloth, held):
        one = lambda c, _: step(spec, c, far, far, at, at, DT, held, floor)  # noqa: E731
        return jax.lax.scan(one, cloth, length=300)

    for held in (True, False):
        end, touch = jax.device_get(fall(start, jnp.bool_(held)))
        height = end.pos_w[:, 2] - floor
        lying = height < spec.fabric.thickness + 1e-3
        assert (height > spec.fabric.thickness - 1e-4).all()
        assert np.linalg.norm(end.vel_w[lying], axis=1).mean() < 0.02  # it slid, and rubbed
        np.testing.assert_allclose(touch.total, 0.0)  # the floor is none of the solids
        free = G * spec.mass[spec.held < 0].sum()
        if held:
            # what lies on the floor does not hang from the hand
            assert lying.mean() > 0.05 and 0.1 < touch.grip_w[-50:, 2].mean() / free < 0.9
        else:
            assert lying.mean() > 0.2 and height.max() < 0.3  # its folds stand up


def test_energy_does_not_grow():
    spec = build_cloth(sheet(0.3, 0.4, 0.025), Fabric(damping=0.0))
    v = spec.garment.vertices
    level = jnp.asarray(v[:, [0, 2, 1]], jnp.float32)  # it will swing
    out = Cloth(level, jnp.zeros_like(level))
    states, _ = run(spec, out, 300, anchors=np.asarray(out.pos_w)[spec.garment.anchors])
    kinetic = 0.5 * (spec.mass * (states.vel_w**2).sum(-1)).sum(-1)
    energy = kinetic + G * (spec.mass * states.pos_w[..., 2]).sum(-1)
    scale = spec.mass.sum() * G * 0.4
    assert energy.max() < 0.01 * scale and energy[-1] < energy[0]
    assert kinetic.max() > 0.05 * scale  # it did swing


def test_momentum_changes_by_gravity_only():
    spec = loose(build_cloth(sheet(0.3, 0.3, 0.025), Fabric(damping=0.0)))
    rng = np.random.default_rng(0)
    start = initial(spec, jnp.zeros(3))
    start = replace(start, vel_w=jnp.asarray(rng.normal(0, 0.3, start.vel_w.shape), jnp.float32))
    states, _ = run(spec, start, 50)
    mass = spec.mass[:, None]
    change = (mass * (states.vel_w[-1] - np.asarray(start.vel_w))).sum(0) / spec.mass.sum()
    np.testing.assert_allclose(change, [0.0, 0.0, -G * 50 * DT], atol=2e-3)


def test_moving_solid_carries_cloth():
    spec = loose(build_cloth(sheet(0.3, 0.2, 0.025), Fabric(friction=0.5, damping=0.0)))
    anchors = anchor_positions(spec, jnp.zeros(3))

    def one(cloth, i):
        at = lambda k: replace(table(), a_w=table().a_w + k, b_w=table().b_w + k)  # noqa: E731
        way = jnp.array([0.1 * DT, 0.0, 0.0])
        return step(spec, cloth, at(i * way), at((i + 1) * way), anchors, anchors, DT)[0], None

    start = lying(spec, 0.008)
    end, _ = jax.jit(lambda c: jax.lax.scan(one, c, jnp.arange(100)))(start)
    moved = np.asarray(end.pos_w - start.pos_w)[:, 0].mean()
    np.testing.assert_allclose(moved, 0.1, atol=0.02)


def test_batched_environments_equal_single_ones():
    spec = build_cloth(sheet(0.2, 0.2, 0.025))
    anchors, solids = anchor_positions(spec, jnp.zeros(3)), table()
    pos = initial(spec, jnp.zeros(3)).pos_w
    vel = jax.random.normal(jax.random.PRNGKey(0), (3, *pos.shape))
    one = lambda v: step(spec, Cloth(pos, v), solids, solids, anchors, anchors, DT)  # noqa: E731
    many, one = jax.jit(jax.vmap(one))(vel), jax.jit(one)
    for i in range(3):
        alone = one(vel[i])
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(many), strict=True):
            np.testing.assert_allclose(a, b[i], atol=2e-5)
    assert np.abs(many[0].pos_w[0] - many[0].pos_w[1]).max() > 1e-3


def test_non_finite_cloth_is_reset_and_reported():
    spec = build_cloth(sheet(0.2, 0.2, 0.025))
    anchors, cloth = anchor_positions(spec, jnp.zeros(3)), initial(spec, jnp.zeros(3))
    wild = replace(cloth, vel_w=cloth.vel_w.at[40, 1].set(jnp.inf))
    one = jax.jit(lambda c: step(spec, c, table(), table(), anchors, anchors, DT))
    after, touch = one(wild)
    assert touch.broken and np.isfinite(after.pos_w).all() and not after.vel_w.any()
    assert not touch.total.any() and not touch.net_w.any() and not touch.grip_w.any()
    _, touch = one(cloth)
    assert not touch.broken
