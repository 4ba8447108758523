# ruff: noqa: D103
"""Limbs as cloth meets them in Assistive Gym: Bullet's distances at the corners of a cell, and what follows from them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.matter.cloth import grid
from agym_jax.matter.shapes import columns

BULLET = (
    (0.033, 0.257, (-0.0329, 0.2170, 0.0885, 0.3206, 0.2450)),
    (0.027, 0.234, (-0.0270, 0.2230, 0.1060, 0.3266, 0.2562)),
    (0.043, 0.279, (-0.0429, 0.2070, 0.0675, 0.3106, 0.2303)),
)
"""Radius and length [m], and btGjkEpaSolver2::SignedDistance at (0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 1, 0) and (1, 0, 1) cells."""
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1]]) * grid.CELL


def path(radius: float, length: float, turn: np.ndarray | None = None) -> grid.GridPath:
    """One shape, in one substep, that moves by 1 mm along x."""
    turn = np.eye(3) if turn is None else turn
    ends = [
        grid.GridShapes(
            jnp.array([[x, 0.0, 0.0]]), jnp.asarray(turn[None]),
            grid.cell_numbers(jnp.array([radius]), jnp.array([length])),
        )
        for x in (-0.001, 0.0)
    ]  # fmt: skip
    return jax.tree.map(lambda x: x[0], grid.grid_path(1, *ends))


@pytest.mark.parametrize(("radius", "length", "found"), BULLET)
def test_corners_are_bullets(radius: float, length: float, found: tuple[float, ...]):
    dist = grid.distance(columns(jnp.asarray(CORNERS)), path(radius, length), 0)
    np.testing.assert_allclose(dist, found, atol=2e-4)


def test_a_forearm_is_a_rhombus_that_tapers_to_its_ends():
    now = path(0.033, 0.257)

    def off(direction: tuple[float, float], z: float) -> float:
        """Distance from the axis at which Bullet keeps cloth, 38 mm off [m]."""
        along = np.linspace(0.0, 0.15, 3001)
        at = np.stack([along * direction[0], along * direction[1], 0 * along + z], -1)
        return along[np.argmax(grid.distance(columns(jnp.asarray(at)), now, 0) > 0.038)]

    assert abs(off((1.0, 0.0), 0.0) - 0.071) < 1e-3  # as a capsule would
    assert abs(off((0.0, -1.0), 0.0) - 0.071) < 1e-3
    assert 0.049 < off((0.7071, 0.7071), 0.0) < 0.056
    assert 0.005 < off((1.0, 0.0), 0.1285) < 0.012  # at the wrist


def test_normals_are_the_slope_of_the_distance_in_the_world():
    turn = np.array([[0.0, -0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, 0.6]])
    now = path(0.033, 0.257, turn)
    at = jnp.array([[0.03, 0.05, -0.04], [-0.05, 0.02, 0.06], [0.04, -0.06, 0.01]])
    slope = jax.vmap(jax.grad(lambda x: grid.distance(columns(x[None]), now, 0)[0]))(at)
    dist, normal, moved = grid.surface(columns(at), now, jnp.zeros(3, jnp.int32))
    np.testing.assert_allclose(dist, grid.distance(columns(at), now, 0), atol=1e-6)
    expected = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack(normal, -1), expected, atol=1e-5)
    np.testing.assert_allclose(np.stack(moved, -1), np.tile([0.001, 0, 0], (3, 1)), atol=1e-7)
