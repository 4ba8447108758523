# ruff: noqa: D103
"""Shapes that particles touch, against brute force: points sampled on them, and finite differences."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.checks import MatterError, capacity, check, speed_limit
from agym_jax.matter.particles.containers import AG_TO_VESSEL, CUP, SPOON, Bowl, Cup, Vessel
from agym_jax.matter.particles.solver import FOOD, WATER, ParticleSpec
from agym_jax.matter.shapes import (
    Boxes,
    Capsules,
    box_distances,
    capsule_distances,
    columns,
    dot,
    floor_distances,
    no_boxes,
    no_capsules,
)

VESSELS = pytest.mark.parametrize("vessel", [CUP, SPOON], ids=["cup", "spoon"])


def cloud(centre: Any, half: Any, n: int = 150) -> np.ndarray:
    """Points in a box [m] (n, 3)."""
    return np.random.default_rng(0).uniform(-1, 1, (n, 3)) * half + centre


def xyz(points: np.ndarray) -> tuple[jax.Array, jax.Array, jax.Array]:
    return columns(jnp.asarray(points, jnp.float32))


def rows(vectors: Any) -> np.ndarray:
    return np.stack(vectors, -1)


def gradient(distance: Any, points: np.ndarray, step: float = 2e-4) -> np.ndarray:
    """Of a function of points (n, 3) -> (n,), by differences (n, 3)."""
    moves = step * np.eye(3)
    return np.stack([(distance(points + m) - distance(points - m)) / (2 * step) for m in moves], -1)


def mid_surface(vessel: Vessel, n: int = 90) -> np.ndarray:
    """Points all over a vessel's mid-surface [m] (m, 3), from its inside by hand."""
    half = vessel.thickness / 2
    if isinstance(vessel, Cup):
        wall = np.array([vessel.rim_radius - vessel.floor_radius, vessel.depth])
        out = np.array([wall[1], -wall[0]]) / np.linalg.norm(wall)
        foot = np.array([vessel.floor_radius, vessel.floor]) + half * out
        foot += wall / wall[1] * (vessel.floor - half - foot[1])
        top = foot + wall / wall[1] * (vessel.rim_height - half - foot[1])
        share = np.linspace(0, 1, n)[:, None]
        profile = np.concatenate(
            [share * foot * [1, 0] + [0, foot[1]], foot + share * (top - foot)]
        )
    else:
        inner = vessel.curvature
        angle = np.linspace(0, np.arcsin(vessel.half_width / inner), n)
        profile = (inner + half) * np.stack([np.sin(angle), -np.cos(angle)], -1) + [0, inner]
    turn = np.linspace(0, 2 * np.pi, 2 * n, endpoint=False)
    r, z = profile[:, :1], profile[:, 1:]
    x, y = r * np.cos(turn), r * np.sin(turn)
    surface = np.stack([x, y + np.sign(y) * vessel.trough, z + 0 * x], -1).reshape(-1, 3)
    along = np.linspace(-1, 1, n) * vessel.trough
    sides = [np.stack([s * r + 0 * along, 0 * r + along, z + 0 * along], -1) for s in (-1, 1)]
    return np.concatenate([surface, *(s.reshape(-1, 3) for s in sides)])


@VESSELS
def test_wall_distance_equals_that_of_the_nearest_sample(vessel: Vessel) -> None:
    points = cloud([0, 0, vessel.depth / 2], [0.06, 0.06, vessel.depth])
    dist, normal = vessel.wall(*xyz(points))
    surface = mid_surface(vessel)
    brute = np.array([np.linalg.norm(surface - p, axis=1).min() for p in points])
    np.testing.assert_allclose(dist, brute, atol=6e-4)
    np.testing.assert_allclose(np.linalg.norm(rows(normal), axis=1), 1.0, atol=1e-5)


@VESSELS
def test_wall_normal_is_the_gradient_of_the_distance(vessel: Vessel) -> None:
    points = cloud([0, 0, vessel.depth / 2], [0.05, 0.05, vessel.depth])
    with jax.enable_x64(True):
        slope = gradient(lambda p: np.asarray(vessel.wall(*columns(jnp.asarray(p)))[0]), points)
    normal = rows(vessel.wall(*xyz(points))[1])
    same = np.linalg.norm(slope - normal, axis=1) < 1e-3
    assert same.mean() > 0.95  # elsewhere two parts of the wall are equally near


@VESSELS
def test_volume_equals_a_monte_carlo_estimate(vessel: Vessel) -> None:
    """Between the inner faces and below the rim, by counting points."""
    half = np.array([0.05, 0.05, vessel.depth / 2])
    inner_top = vessel.rim_height if isinstance(vessel, Cup) else vessel.rim_depth
    low = inner_top - vessel.depth
    points = cloud([0, 0, low + half[2]], half, 60_000)
    columns_of = xyz(points)
    clear = np.asarray(vessel.wall(*columns_of)[0]) > vessel.thickness / 2
    radius = np.asarray(vessel.polar(*columns_of[:2])[0])
    near_brim = points[:, 2] > vessel.brim[1]
    within = np.where(near_brim, radius < vessel.brim[0], np.asarray(vessel.holds(*columns_of)))
    volume = (within & clear).mean() * 8 * half.prod()
    assert vessel.volume == pytest.approx(volume, rel=0.03)


@pytest.mark.parametrize(
    ("vessel", "point", "is_held"),
    [
        (CUP, (0.0, 0.0, 0.02), True), (CUP, (0.0, 0.0, -0.01), False), (CUP, (0.0, 0.0, 0.13), False),
        (CUP, (0.05, 0.0, 0.05), False), (CUP, (0.0, -0.036, 0.12), True),
        (SPOON, (0.0, 0.0, 0.005), True), (SPOON, (0.0, 0.021, 0.008), True),
        (SPOON, (0.021, 0.0, 0.008), False), (SPOON, (0.0, 0.0, -0.004), False),
        (SPOON, (0.0, 0.0, 0.02), False),
    ],
)  # fmt: skip
def test_holds_is_true_inside_only(vessel: Vessel, point: tuple, is_held: bool) -> None:
    assert bool(vessel.holds(*map(jnp.float32, point))) == is_held


@pytest.mark.parametrize(
    ("start", "end", "passes"),
    [
        ((0, 0, 0.11), (0, 0, 0.13), True), ((0, 0, 0.13), (0.01, 0, 0.11), True),
        ((0, 0, 0.10), (0, 0, 0.11), False), ((0.07, 0, 0.11), (0.07, 0, 0.13), False),
        ((0.03, 0, 0.05), (0.06, 0, 0.05), False), ((0.03, 0, 0.11), (0.09, 0, 0.13), False),
    ],
)  # fmt: skip
def test_passes_detects_paths_through_the_opening(start: tuple, end: tuple, passes: bool) -> None:
    ways = (tuple(map(jnp.float32, x)) for x in (start, end))
    assert bool(CUP.passes(*ways)) == passes


def test_vessel_sizes_match_assistive_gym() -> None:
    """Reference furniture.md sections 6 and 7."""
    for z, inner in (
        (0.012, 0.030),
        (0.02, 0.0311),
        (0.06, 0.036),
        (0.095, 0.0402),
        (0.12, 0.0406),
    ):
        grow = (z - CUP.floor) / CUP.depth * (CUP.rim_radius - CUP.floor_radius)
        assert CUP.floor_radius + grow == pytest.approx(inner, abs=2e-3)
    assert CUP.brim[0] + CUP.thickness / 2 == pytest.approx(0.0477, abs=1e-3)
    assert SPOON.curvature == pytest.approx(0.020, abs=1.5e-3)
    assert 0.008 <= SPOON.rim_depth <= 0.0117
    assert SPOON.brim[0] + SPOON.thickness / 2 == pytest.approx(0.018, abs=2.5e-3)
    up = np.asarray(rotation_matrix(jnp.asarray(AG_TO_VESSEL), normalize=True)) @ [0, 1, 0]
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-6)


def test_capsule_distances_match_closed_form() -> None:
    a, b = np.array([[0, 0, 1.0], [1, 1, 1]]), np.array([[0.5, 0, 1.0], [1, 1, 1]])
    radius, moved = np.array([0.1, 0.2]), np.array([0.01, 0.0, -0.02])
    points = cloud([0.5, 0.5, 1.0], 1.0)
    now = Capsules(*(jnp.asarray(x, jnp.float32) for x in (a, b, radius)))
    before = Capsules(now.a_w - moved, now.b_w - moved, now.radius)
    seen = jax.jit(capsule_distances)(xyz(points), now.ends(), before.ends(), now.radius)
    share = np.linspace(0, 1, 1000)[:, None]
    for k in range(2):
        segment = a[k] + share * (b[k] - a[k])
        brute = np.array([np.linalg.norm(segment - p, axis=1).min() for p in points]) - radius[k]
        np.testing.assert_allclose(seen.dist[k], brute, atol=1e-5)
    np.testing.assert_allclose(
        rows(seen.moved)[:, :, :], np.broadcast_to(moved, (2, 150, 3)), atol=1e-6
    )
    np.testing.assert_allclose(np.asarray(dot(seen.normal, seen.normal)), 1.0, atol=1e-5)


def test_rotating_capsule_moves_at_the_nearest_point() -> None:
    before = Capsules(jnp.zeros((1, 3)), jnp.array([[1.0, 0, 0]]), jnp.array([0.1]))
    now = Capsules(jnp.zeros((1, 3)), jnp.array([[1.0, 0, 0.04]]), jnp.array([0.1]))
    seen = capsule_distances(
        xyz(np.array([[0.25, 0, 0.2], [2.0, 0, 0]])), now.ends(), before.ends(), now.radius
    )
    np.testing.assert_allclose(seen.moved[2], [[0.01, 0.04]], atol=5e-4)


def test_box_distances_match_closed_form() -> None:
    quat = np.array([0.8, 0.0, 0.6, 0.0])
    rot, pos, half = (
        np.asarray(rotation_matrix(jnp.asarray(quat), normalize=True)),
        np.array([0.1, 0, 0.5]),
        np.array([0.2, 0.1, 0.05]),
    )
    box = Boxes(*(jnp.asarray(x, jnp.float32)[None] for x in (pos, quat, half)))
    points = cloud(pos, 0.4)
    seen = jax.jit(box_distances)(xyz(points), *box.columns())
    local = (points - pos) @ rot
    nearest = np.clip(local, -half, half)
    outside = np.linalg.norm(local - nearest, axis=1)
    inside = (half - np.abs(local)).min(1)
    expected = np.where(outside > 0, outside, -inside)
    assert (expected < 0).any()
    np.testing.assert_allclose(seen.dist[0], expected, atol=1e-6)
    surface = points - np.asarray(seen.dist[0])[:, None] * rows(seen.normal)[0]
    off = np.abs((surface - pos) @ rot) - half
    np.testing.assert_allclose(off.max(1), 0.0, atol=1e-6)  # back along the normal lies the surface


def test_floor_distances_and_empty_sets() -> None:
    points = xyz(np.array([[3.0, -2.0, 0.4], [0.0, 0.0, -0.1]]))
    floor = floor_distances(points, jnp.float32(0.1))
    np.testing.assert_allclose(floor.dist, [[0.3, -0.2]], atol=1e-6)
    nobody = no_capsules()
    for nothing in (
        capsule_distances(points, nobody.ends(), nobody.ends(), nobody.radius),
        box_distances(points, *no_boxes().columns()),
    ):
        assert nothing.dist.shape == nothing.normal[2].shape == (0, 2)


def test_gradients_are_finite_where_lengths_are_zero() -> None:
    """On a sphere's centre, in a box's middle, on the cup's axis and at the end of its wall."""
    ball = Capsules(jnp.zeros((1, 3)), jnp.zeros((1, 3)), jnp.array([0.1]))
    box = Boxes(jnp.zeros((1, 3)), jnp.array([[1.0, 0, 0, 0]]), jnp.full((1, 3), 0.1))

    def total(point: jax.Array) -> jax.Array:
        p = columns(point[None])
        walls = sum(jnp.sum(v.wall(*p)[0]) + jnp.sum(v.reach(p[2])) for v in (CUP, SPOON))
        in_ball = capsule_distances(p, ball.ends(), ball.ends(), ball.radius)
        return jnp.sum(in_ball.dist) + jnp.sum(box_distances(p, *box.columns()).dist) + walls

    brim = [CUP.brim[0], 0.0, CUP.brim[1]]
    points = jnp.array([[0.0, 0, 0], [0.0, 0, 0.05], brim, [0.0, SPOON.trough, 0.001]])
    assert np.isfinite(jax.jit(jax.vmap(jax.grad(total)))(points)).all()


def test_capacity_of_cup_and_spoon() -> None:
    assert capacity(SPOON, FOOD.radius) == pytest.approx(15, abs=2)
    assert capacity(CUP, WATER.radius) > 400
    assert capacity(CUP, 2 * WATER.radius) < capacity(CUP, WATER.radius) / 6


@pytest.mark.parametrize(
    ("changes", "dt", "words"),
    [
        ({"count": 40}, 0.01, "40 particles of radius 0.005 m do not fit .* it holds 15"),
        ({"vessel": None}, 0.01, "8 particles need a vessel, got None"),
        ({"substeps": 1}, 0.01, r"could cross a wall within one substep of 10.00 ms; the limit is 3.00 m/s.* substeps=2"),
        ({"substeps": 0}, 0.01, "need substeps > 0, got 0"),
        ({"radius": -1.0}, 0.01, "need radius > 0"),
    ],
)  # fmt: skip
def test_invalid_particles_are_refused_with_the_limit(changes: dict, dt: float, words: str) -> None:
    spec = ParticleSpec(**({"vessel": SPOON, "count": 8, "substeps": 3} | changes))
    with pytest.raises(MatterError, match=words):
        check(spec, dt, thinnest=0.025)


def test_food_and_water_are_accepted() -> None:
    check(FOOD, 0.01, thinnest=0.02)
    check(WATER, 0.01, thinnest=0.02)
    assert speed_limit(WATER, 0.01, 0.02) == pytest.approx(0.025 / 0.0025)


def test_bowl_without_trough_is_a_surface_of_revolution() -> None:
    dish = Bowl(half_width=0.02, half_length=0.02, rim_depth=0.01, thickness=0.002)
    p = cloud([0, 0, 0.01], 0.03)
    turned = p[:, [1, 0, 2]] * [-1, 1, 1]
    np.testing.assert_allclose(dish.wall(*xyz(p))[0], dish.wall(*xyz(turned))[0], atol=1e-6)


def test_incomplete_vessel_class_is_refused() -> None:
    class Thimble(Cup):
        reach = Vessel.reach

    with pytest.raises(TypeError, match=r"Thimble.*reach"):
        Thimble(floor=0.01, floor_radius=0.01, rim_radius=0.01, rim_height=0.02, thickness=0.001)
