# ruff: noqa: D103
"""Limbs as AG's cloth finds them: against an interpolation between eight points, and as solids."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cloth_scene import DT, sheet
from scipy.optimize import brentq

from agym_jax.matter.cloth.grid import SPACING, Grid, interpolated
from agym_jax.matter.cloth.solver import Cloth, step
from agym_jax.matter.cloth.topology import GOWN_FABRIC, build_cloth
from agym_jax.matter.shapes import Capsules

HALVES = [0.0, 0.117, 0.14]  # of a sphere, a woman's forearm and a man's upper arm [m]


def from_axis(points: np.ndarray, half: float) -> np.ndarray:
    """Distance of points (..., 3) from the axis of a capsule, along z [m]."""
    beyond = np.maximum(np.abs(points[..., 2]) - half, 0.0)
    return np.linalg.norm(np.stack([points[..., 0], points[..., 1], beyond], -1), axis=-1)


def between_eight(point: np.ndarray, half: float) -> float:
    """The distance of a point, linear between those of the points of the grid around it [m]."""
    low = np.floor(point / SPACING)
    share, found = point / SPACING - low, 0.0
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, share, 1 - share).prod()
        found += weight * from_axis(SPACING * (low + corner), half)
    return float(found)


@pytest.mark.parametrize("half", HALVES)
def test_distances_are_linear_between_the_points_of_the_grid(half: float):
    rng = np.random.default_rng(0)
    points = rng.uniform(0.001, SPACING, (200, 3)) * rng.choice((-1, 1), (200, 3))
    given = tuple(jnp.asarray(x, jnp.float32) for x in points.T)
    found, steepest, known = interpolated(given, jnp.float32(half))
    assert known.all()
    np.testing.assert_allclose(found, [between_eight(x, half) for x in points], atol=1e-6)
    e = 1e-4
    slope = [
        [between_eight(x + step, half) - between_eight(x - step, half) for step in e * np.eye(3)]
        for x in points
    ]
    slope = np.array(slope) / np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack(steepest, -1), slope, atol=1e-3)
    corners = tuple(jnp.array([0.0, SPACING, 0.0]) for _ in range(3))
    assert interpolated(corners, jnp.float32(half))[2].tolist() == [True, False, True]


def test_a_sphere_is_an_octahedron():
    def surface(way: tuple[float, float, float], radius: float) -> float:
        unit = np.array(way) / np.linalg.norm(way)

        def at(far: float) -> float:
            point = tuple(jnp.float32(x) for x in far * unit)
            return float(interpolated(point, jnp.float32(0))[0])

        return brentq(lambda far: at(far) - radius, 0.0, 0.2)

    assert surface((1, 0, 0), 0.02) == pytest.approx(0.02, abs=1e-5)
    assert surface((0, 0, 1), 0.02) == pytest.approx(0.02, abs=1e-5)
    assert surface((1, 1, 1), 0.001) == pytest.approx(0.001 / 3**0.5, rel=0.01)
    assert 0.001 / 3**0.5 < surface((1, 1, 1), 0.07) / 70 < 0.001 * 0.65  # less so with size


def fallen(grid: Grid | None) -> tuple[float, float, float]:
    """How far cloth beside the crest of a capsule along x falls in a step, as a share of its free fall.

    Returns:
        in the middle of the capsule and at its end, and the force on it [N].
    """
    long, radius, speed = 0.2, 0.05, 0.1
    spec = build_cloth(sheet(long, 0.025, 0.025, "corner"), GOWN_FABRIC)
    v = spec.garment.vertices
    level = np.stack([v[:, 0], v[:, 2] - v[:, 2].mean(), np.full(len(v), 0.025)], -1)
    pos = jnp.asarray(level, jnp.float32)
    falling = Cloth(pos, jnp.zeros_like(pos).at[:, 2].set(-speed))
    beam = Capsules(
        jnp.array([[0.0, 0.0, -radius]]), jnp.array([[long, 0.0, -radius]]), jnp.array([radius])
    )
    at = pos[jnp.asarray(spec.garment.anchors)]
    run = lambda c: step(spec, c, beam, beam, at, at, DT, jnp.bool_(False), None, grid)  # noqa: E731
    cloth, touch = jax.jit(run)(falling)
    down = (pos[:, 2] - cloth.pos_w[:, 2]) / (speed * DT)
    middle, end = (abs(pos[:, 0] - x) < 0.013 for x in (long / 2, long))
    return float(down[middle].mean()), float(down[end].mean()), float(touch.total[0])


def test_a_capsule_found_by_the_grid_stops_cloth_in_its_middle_and_not_at_its_ends():
    along_x = jnp.array([[[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]])
    whole = fallen(None)
    off, on = (fallen(Grid(along_x, jnp.float32(x), (0,))) for x in (0, 1))
    assert max(whole[:2]) < 0.3 and whole[2] > 0
    np.testing.assert_allclose(off, whole, rtol=1e-3)
    assert on[0] < 0.3 and on[1] > 0.8 and on[2] > 0
    np.testing.assert_allclose(fallen(Grid(along_x, jnp.float32(1), ())), whole, rtol=1e-3)
