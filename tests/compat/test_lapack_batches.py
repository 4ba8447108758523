# ruff: noqa: D103
"""Large batches of Cholesky factorisations: they hang without the repair, run with it, and have the same values."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paths import ROOT

from agym_jax.compat import lapack_batches
from agym_jax.sim import mjx as mjx_physics  # applies the repair

onlycpu = pytest.mark.skipif(jax.default_backend() != "cpu", reason="acts on the CPU only")
SIDE = 12
LARGE = 700
"""A batch that is made in pieces, with a remainder: 303 factorisations at a time, 455 solutions."""
HANG_SECONDS = 12
"""Without the repair nothing happens any more after the first; the program takes 2 s with it."""
SEVERAL_AT_A_TIME = """
import os, sys
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])  # before JAX counts the cores
import jax, jax.numpy as jnp
from agym_jax.compat import lapack_batches
print(lapack_batches.apply(), flush=True)
matrices = 12 * jnp.eye(12) + jnp.ones((6, 1024, 12, 12))
def solve(a, b):
    return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(a + 0 * b[0]), b)
def again(_, xs):
    return [0.5 * x + jax.vmap(solve)(a, x) for a, x in zip(matrices, xs)]
run = jax.jit(lambda xs: jax.lax.fori_loop(0, 100, again, xs))
print(float(run([jnp.ones((1024, 12))] * 6)[0].sum()))
"""
MANY_ENVIRONMENTS = """
import os
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
import agym_jax, jax
from agym_jax.wrappers import vectorize
envs = vectorize(agym_jax.make("ReachingJaco-v0", impl="jax"), 2048)
state = jax.jit(envs.reset)(jax.random.key(0))
step = jax.jit(envs.step)
for _ in range(2):
    state = step(state, jax.numpy.ones((2048, envs.action_size)))
print(state.obs.shape, bool(jax.numpy.isfinite(state.obs).all()))
"""


def positive(*batch: int) -> np.ndarray:
    """Positive matrices (..., SIDE, SIDE)."""
    factors = np.random.default_rng(0).normal(size=(*batch, SIDE, SIDE)).astype(np.float32)
    return factors @ np.swapaxes(factors, -1, -2) + np.eye(SIDE, dtype=np.float32)


def solve(matrix, right):
    return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), right)


def loops(function, *inputs) -> int:
    return jax.jit(function).lower(*inputs).as_text().count("stablehlo.while")


@pytest.mark.parametrize(
    ("most", "shapes", "count"),
    [
        (1000, [(10, 10)], None),  # one matrix is never divided
        (1000, [(1, 20, 20)], None),
        (1000, [(2, 20, 20)], 1),
        (8000, [(8, 10, 10)], None),
        (8000, [(9, 10, 10)], 8),
        (8000, [(3, 3, 10, 10)], 8),
        (1000, [(11, 10, 10), (11, 10, 1)], 10),
        (1000, [(0, 10, 10)], None),
        (1000, [(5, 0, 0)], None),
    ],
)
def test_pieces_are_as_large_as_may_be(most, shapes, count):
    assert lapack_batches.piece(most, *shapes) == count


@onlycpu
def test_values_and_derivatives_are_those_of_small_batches():
    matrices, right = positive(LARGE), np.ones((LARGE, SIDE), np.float32)
    both = jax.jit(jax.vmap(jax.value_and_grad(lambda a, b: solve(a, b).sum(), argnums=(0, 1))))
    assert loops(both, matrices, right) and not loops(both, matrices[:25], right[:25])
    whole = both(matrices, right)
    parts = [both(matrices[i : i + 25], right[i : i + 25]) for i in range(0, LARGE, 25)]
    jax.tree.map(
        lambda a, *b: np.testing.assert_allclose(a, np.concatenate(b), 1e-4, 1e-4), whole, *parts
    )
    exact = np.linalg.solve(matrices.astype(float), right[..., None].astype(float))[..., 0].sum(-1)
    np.testing.assert_allclose(whole[0], exact, rtol=1e-3, atol=1e-3)


@onlycpu
def test_batches_of_batches_are_counted_together():
    seeds = positive(7, 100)
    right = np.ones((7, 100, SIDE), np.float32)
    nested = jax.jit(jax.vmap(jax.vmap(solve)))
    assert loops(nested, seeds, right)
    flat = jax.jit(jax.vmap(solve))(seeds.reshape(LARGE, SIDE, SIDE), right.reshape(LARGE, SIDE))
    np.testing.assert_array_equal(nested(seeds, right).reshape(LARGE, SIDE), flat)


@onlycpu
def test_a_matrix_that_is_not_positive_gives_nan_alone():
    matrices = positive(LARGE)
    matrices[650] *= -1
    found = jax.jit(jnp.linalg.cholesky)(matrices)
    assert np.isnan(found[650]).any() and np.isfinite(np.delete(found, 650, axis=0)).all()


def test_physics_on_mjx_applies_it():
    assert mjx_physics.lapack_batches.apply()
    lapack_batches.apply()  # twice is fine


def run(code: str, seconds: float, compat: str = "") -> str:
    """What a program prints; ``subprocess.TimeoutExpired`` if it hangs."""
    environment = {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu", "AGYM_JAX_COMPAT": compat}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=seconds, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_jaxlib_still_hangs_by_itself():
    """If this fails, jaxlib may have mended it: ``agym_jax/compat/lapack_batches.py`` could go."""
    for _ in range(4):
        try:
            said = run(SEVERAL_AT_A_TIME, HANG_SECONDS, "-lapack_batches")
        except subprocess.TimeoutExpired as hung:
            assert hung.stdout.split() == [b"False"]
            return
        assert said.startswith("False")
    pytest.fail("four runs without the repair, and none hung")


@pytest.mark.slow
def test_with_the_repair_it_does_not():
    for _ in range(2):
        assert run(SEVERAL_AT_A_TIME, 5 * HANG_SECONDS).startswith("True")


@pytest.mark.slow
def test_two_thousand_environments_step_on_two_cores():
    assert run(MANY_ENVIRONMENTS, 400) == "(2048, 21) True\n"
