# ruff: noqa: D103
"""The patch of MJX's quaternion product is in place, harmless, and still worth having."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled import BATCH
from mujoco import mjx
from mujoco.mjx._src import math as mjx_math

from agym_jax.compat import mjx_quat
from agym_jax.sim import mjx as mjx_physics  # patches MJX

onlycpu = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="the patch acts on the CPU only"
)


def test_mjx_uses_the_patched_product():
    assert mjx_physics.mjx is mjx
    assert mjx_math.quat_mul is mjx_quat._quat_mul
    assert mjx_quat._original is not mjx_quat._quat_mul
    mjx_quat.apply()  # twice is fine
    assert mjx_math.quat_mul is mjx_quat._quat_mul


def test_values_are_the_originals():
    u, v = np.random.default_rng(0).normal(size=(2, 32, 4)).astype(np.float32)
    both = jax.jit(lambda u, v: (mjx_math.quat_mul(u, v), mjx_quat._original(u, v)))
    mine, theirs = jax.vmap(both)(u, v)
    np.testing.assert_array_equal(mine, theirs)


@onlycpu
def test_the_barrier_is_in_what_is_compiled():
    text = jax.jit(mjx_math.quat_mul).lower(jnp.ones(4), jnp.ones(4)).as_text()
    assert "optimization_barrier" in text
    assert (
        "optimization_barrier"
        not in jax.jit(mjx_quat._original).lower(jnp.ones(4), jnp.ones(4)).as_text()
    )


@onlycpu
@pytest.mark.jit
def test_kinematics_computes_every_link_once(static_env):
    """By what is compiled: 18 thousand operations for eight worlds. Links that compute their parents anew need many more."""
    model, data = static_env.physics.model, mjx.make_data(static_env.scene.model)
    run = jax.jit(jax.vmap(lambda q: mjx.kinematics(model, data.replace(qpos=q)).xpos))
    lowered = run.lower(jax.ShapeDtypeStruct((BATCH, model.nq), jnp.float32))
    assert lowered.as_text().count("optimization_barrier") >= model.njnt
    compiled = lowered.compile()
    assert compiled.cost_analysis()["flops"] < 1e5
    qpos = np.random.default_rng(0).normal(size=(BATCH, model.nq)).astype(np.float32)
    assert np.isfinite(compiled(qpos)).all()
