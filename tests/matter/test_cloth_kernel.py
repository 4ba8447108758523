# ruff: noqa: D103
"""The cloth's GPU kernel, in interpret mode on a CPU, against XLA."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scene import DT, sheet
from scipy.spatial.transform import Rotation

from agym_jax.matter.cloth import solver as fabrics
from agym_jax.matter.cloth.garment import load
from agym_jax.matter.cloth.grid import Grid
from agym_jax.matter.cloth.kernel import kernel
from agym_jax.matter.cloth.solver import Cloth, anchor_positions, initial, step
from agym_jax.matter.cloth.topology import ClothSpec, Fabric, build_cloth
from agym_jax.matter.shapes import Capsules

NUM_ENVS = 3
FLOOR = -0.3
GRID = Grid(
    jnp.asarray(Rotation.random(2, random_state=0).as_matrix(), jnp.float32), jnp.float32(1), (0, 1)
)


def small() -> ClothSpec:
    """A sheet of 63 vertices: one less than the arrays of a kernel have."""
    return build_cloth(sheet(0.2, 0.15, 0.025), Fabric(substeps=3))


def batch(spec: ClothSpec) -> tuple[Cloth, Capsules, Capsules, jax.Array]:
    """Cloth that moves, two capsules that move into it, and whether it is held."""
    rng = np.random.default_rng(0)
    still = initial(spec, jnp.zeros(3))
    speed = rng.normal(0.0, 0.5, (NUM_ENVS, spec.count, 3)).astype(np.float32)
    pos = jnp.broadcast_to(still.pos_w, speed.shape) - 0.05 * jnp.arange(NUM_ENVS)[:, None, None]
    a = np.tile(np.float32([[0.0, -0.04, -0.1], [0.1, -0.05, -0.05]]), (NUM_ENVS, 1, 1))
    start = Capsules(
        jnp.asarray(a), jnp.asarray(a + np.float32([0.1, 0.0, 0.02])), jnp.full(a.shape[:2], 0.03)
    )
    end = replace(start, a_w=start.a_w + 0.01, b_w=start.b_w + 0.02)
    return Cloth(pos, jnp.asarray(speed)), start, end, jnp.array([True, False, True])


def stepped(spec: ClothSpec, steps: int, grid: Grid | None = None) -> Callable:
    """A function of ``batch`` that returns the cloth, and the contacts of each of some physics steps."""
    at = anchor_positions(spec, jnp.zeros(3))

    def run(cloth: Cloth, start: Capsules, end: Capsules, held: jax.Array) -> tuple:
        one = lambda c, _: step(spec, c, start, end, at, at + 0.002, DT, held, FLOOR, grid)  # noqa: E731
        return jax.lax.scan(one, cloth, length=steps)

    return jax.vmap(run)


@pytest.mark.parametrize(("whole", "grid"), [(False, None), (False, GRID), (True, None)])
def test_kernel_equals_xla(monkeypatch: pytest.MonkeyPatch, whole: bool, grid: Grid | None):
    spec = build_cloth(load()) if whole else small()
    given = batch(spec)
    expected = jax.jit(stepped(spec, 1 if whole else 4, grid))(*given)
    monkeypatch.setattr(fabrics, "advance", partial(kernel, interpret=True))
    made = jax.jit(stepped(spec, 1 if whole else 4, grid))(*given)
    cloth, touch = expected
    assert touch.total.sum() > (1.0 if grid is None else 0.5) and not touch.broken.any()
    assert np.abs(cloth.pos_w - given[0].pos_w).max() > 1e-3
    for a, b in zip(jax.tree.leaves(made), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(made[0].pos_w, cloth.pos_w, atol=2e-6)


def test_a_grid_that_is_off_changes_nothing():
    spec = small()
    plain, off, on = (
        jax.jit(stepped(spec, 2, grid))(*batch(spec))[1].total.sum(-1)
        for grid in (None, replace(GRID, on=jnp.float32(0)), GRID)
    )
    np.testing.assert_allclose(off, plain, rtol=1e-4)
    assert (abs(on - plain) > 0.1).any()


def test_kernel_holds_the_anchors_by_default(monkeypatch: pytest.MonkeyPatch):
    spec = small()
    cloth, start, end, _ = jax.tree.map(lambda x: x[0], batch(spec))
    at = anchor_positions(spec, jnp.zeros(3))
    one = lambda held: step(spec, cloth, start, end, at, at, DT, held)[0].pos_w  # noqa: E731
    expected = one(jnp.bool_(True))
    monkeypatch.setattr(fabrics, "advance", partial(kernel, interpret=True))
    np.testing.assert_allclose(one(None), expected, atol=1e-6)


@pytest.mark.parametrize("interpret", [False, True])
def test_non_finite_solid_marks_the_cloth_as_broken(
    monkeypatch: pytest.MonkeyPatch, interpret: bool
):
    spec = small()
    cloth, start, end, held = jax.tree.map(lambda x: x[0], batch(spec))
    at, lost = anchor_positions(spec, jnp.zeros(3)), replace(end, a_w=end.a_w.at[0].set(jnp.nan))
    if interpret:
        monkeypatch.setattr(fabrics, "advance", partial(kernel, interpret=True))
    after, touch = jax.jit(lambda c: step(spec, c, start, lost, at, at, DT, held))(cloth)
    assert touch.broken and np.isfinite(after.pos_w).all() and not touch.total.any()


@pytest.mark.parametrize("grid", [None, GRID])
def test_physics_step_is_one_kernel_on_a_gpu(grid: Grid | None):
    spec = build_cloth(load())
    lowered = (
        jax.jit(stepped(spec, 1, grid)).trace(*batch(spec)).lower(lowering_platforms=("cuda",))
    )
    assert lowered.as_text().count("__gpu$xla.gpu.triton") == 1


@pytest.mark.slow
def test_derivatives_equal_finite_differences():
    spec = small()
    cloth, start, end, held = jax.tree.map(lambda x: x[0], batch(spec))
    at = anchor_positions(spec, jnp.zeros(3))

    def height(lift: jax.Array) -> jax.Array:
        up = jnp.array([0.0, 0.0, 1.0]) * lift
        moved = replace(end, a_w=end.a_w + up, b_w=end.b_w + up)
        return step(spec, cloth, start, moved, at, at, DT, held)[0].pos_w[:, 2].mean()

    near = 1e-3
    slope = (height(jnp.float32(near)) - height(jnp.float32(-near))) / (2 * near)
    np.testing.assert_allclose(jax.grad(height)(jnp.float32(0.0)), slope, rtol=0.1)
    assert abs(slope) > 1e-3
