# ruff: noqa: D103
"""``fused_scan`` as a GPU kernel, in interpret mode on a CPU, against XLA: particles in busy scenes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.matter.fused_scan import kernel
from agym_jax.matter.particles import solver
from agym_jax.matter.particles.solver import (
    FOOD,
    WATER,
    Obstacles,
    Particles,
    ParticleSpec,
    advance,
)
from agym_jax.matter.shapes import Boxes, Capsules


def busy(spec: ParticleSpec) -> tuple[Particles, Obstacles]:
    """Three environments, two physics steps: colliding particles, some masked, a tilted vessel, nine capsules, a box, a floor."""
    rng = np.random.default_rng(3)

    def moving(centre: Any, half: float, *shape: int) -> jax.Array:
        start, way = rng.uniform(-half, half, (2, 3, 1, *shape))
        times = np.arange(3.0).reshape(1, 3, *[1] * len(shape))
        return jnp.asarray(start + centre + 0.1 * times * way, jnp.float32)

    middle, upright = np.array([0, 0, 0.015]), np.array([1.0, 0, 0, 0])
    centres = jnp.asarray(middle + rng.uniform(-0.02, 0.02, (3, spec.count, 3)), jnp.float32)
    speed = jnp.asarray(rng.normal(0, 0.3, centres.shape), jnp.float32)
    alive = jnp.asarray(rng.uniform(size=centres.shape[:2]) < 0.8)
    obstacles = Obstacles(
        vessel_pos_w=moving([0, 0, 0], 0.01, 3),
        vessel_quat_w=moving(upright, 0.5, 4),
        human=Capsules(
            moving(middle, 0.05, 9, 3), moving(middle, 0.05, 9, 3), jnp.full((3, 9), 0.01)
        ),
        furniture=Boxes(
            moving(middle, 0.02, 1, 3)[:, 0],
            moving(upright, 0.5, 1, 4)[:, 0],
            jnp.full((3, 1, 3), 0.01),
        ),
        floor=jnp.full(3, -0.002),
    )
    return Particles(centres, speed, alive), obstacles


@pytest.mark.parametrize("spec", [FOOD, WATER], ids=["food", "water"])
def test_kernel_equals_xla(spec: ParticleSpec, monkeypatch: Any) -> None:
    """In interpret mode on a CPU; and a GPU runs the kernel."""
    environments = busy(spec)
    plain = jax.jit(jax.vmap(lambda p, m: advance(spec, p, m, 0.01)))
    expected, touched = plain(*environments)
    for_gpu = plain.trace(*environments).lower(lowering_platforms=("cuda",)).as_text()
    assert for_gpu.count("__gpu$xla.gpu.triton") == 1
    assert "triton" not in plain.lower(*environments).as_text()
    monkeypatch.setattr(solver, "fused_scan", partial(kernel, interpret=True))
    whole = jax.jit(jax.vmap(lambda p, m: advance(spec, p, m, 0.01)))
    after, contact = whole(*environments)
    np.testing.assert_allclose(after.pos_w, expected.pos_w, atol=2e-6)
    np.testing.assert_allclose(after.vel_w, expected.vel_w, atol=2e-3)
    np.testing.assert_array_equal(after.alive, environments[0].alive)
    for name in ("vessel", "human", "furniture", "floor"):
        np.testing.assert_array_equal(getattr(contact, name), getattr(touched, name))
        assert np.any(getattr(contact, name))  # so that all constraints are compared


def test_sizes_that_are_not_powers_of_two_use_xla() -> None:
    spec = replace(FOOD, count=6)
    run = jax.jit(jax.vmap(lambda p, m: advance(spec, p, m, 0.01)))
    for_gpu = run.trace(*busy(spec)).lower(lowering_platforms=("cuda",)).as_text()
    assert "triton" not in for_gpu


def test_kernel_refuses_more_vectors_than_scratch_rows() -> None:
    def body(x: jax.Array, *unused: Any) -> jax.Array:
        return unused[-1](lambda rows: rows[0][:, None] * x, [x] * 17)

    with pytest.raises(ValueError, match="has 16 rows, got 17 vectors"):
        kernel(body, jnp.ones(64), jnp.zeros(3), jnp.float32(0.0), interpret=True)


def test_derivatives_of_a_scan_are_finite() -> None:
    """They are those of the XLA version, also where a kernel could run."""
    state, motion = jax.tree.map(lambda x: x[0], busy(FOOD))
    once = replace(FOOD, substeps=1, sweeps=1)

    def after(pos_w: jax.Array) -> jax.Array:
        return advance(once, replace(state, pos_w=pos_w), motion, 0.01)[0].pos_w

    up = jnp.ones_like(state.pos_w)
    change = np.asarray(jax.jit(lambda p: jax.jvp(after, (p,), (up,))[1])(state.pos_w))
    assert np.isfinite(change).all() and np.any(change != 1.0)
    np.testing.assert_array_equal(change[~np.asarray(state.alive)], 1.0)
