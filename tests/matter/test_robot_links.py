# ruff: noqa: D103
"""The robot's links as AG's cloth finds them: distances read off a grid, and cloth that meets them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from cloth_scene import DT, NOTHING, sheet
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from agym_jax.data.assets import asset_path
from agym_jax.errors import SpecError
from agym_jax.matter.cloth import solver as fabrics
from agym_jax.matter.cloth.grid import SPACING, Grid
from agym_jax.matter.cloth.kernel import InArrays, kernel
from agym_jax.matter.cloth.nearest import Solids, nearest, trajectory
from agym_jax.matter.cloth.robot_links import (
    LINKS,
    Layout,
    LinkGrids,
    Links,
    link_grids,
    read_off,
)
from agym_jax.matter.cloth.solver import Cloth, ClothContact, step
from agym_jax.matter.cloth.topology import GOWN_FABRIC, build_cloth
from agym_jax.matter.shapes import Capsules
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene
from agym_jax.sim.sensing import motion_at_rest
from agym_jax.spec import RobotSpec
from agym_jax.tasks.dressing import DRESSING

RADIUS, LONG = 0.05, 0.2  # of a capsule along x [m]
POINTS = SPACING * np.arange(-2, 3)


def capsule_distance(points: np.ndarray) -> np.ndarray:
    """Distance of points (..., 3) from a capsule along z around the origin [m]."""
    beyond = np.maximum(np.abs(points[..., 2]) - LONG / 2, 0.0)
    return np.linalg.norm(np.stack([points[..., 0], points[..., 1], beyond], -1), axis=-1) - RADIUS


def tabulated() -> LinkGrids:
    """That capsule as a shape of a robot whose only link has its frame."""
    points = np.stack(np.meshgrid(POINTS, POINTS, POINTS, indexing="ij"), -1)
    layout = Layout((-2, -2, -2), (5, 5, 5), 0)
    distances = capsule_distance(points).astype(np.float32).ravel()
    none = np.zeros((1, 3), np.float32)
    return LinkGrids(
        np.zeros(1, int), none, np.eye(3, dtype=np.float32)[None], (layout,), distances
    )


CAPSULE = tabulated()
ALONG_X = np.float32([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Axes of a grid whose z axis is the world's x axis, in its columns."""


def frame(pos: tuple[float, float, float]) -> jax.Array:
    """``LinkGrids.frames`` of the capsule, along x, with its middle at a place (1, 12)."""
    return CAPSULE.frames(jnp.array([[pos]]), jnp.asarray(ALONG_X)[None, None])[0]


def test_distances_are_linear_between_the_points_of_the_grid():
    rng = np.random.default_rng(0)
    layout = Layout((-1, 0, -2), (3, 2, 4), 7)
    values = rng.uniform(-0.1, 0.6, layout.points)
    row = jnp.asarray(np.concatenate([np.full(7, 9.0), values.ravel(), np.full(5, 9.0)])[None])
    low = SPACING * np.array(layout.first)
    high = low + SPACING * (np.array(layout.points) - 1)
    axes = [a + SPACING * np.arange(n) for a, n in zip(low, layout.points, strict=True)]
    expected = RegularGridInterpolator(axes, values)
    points, e = rng.uniform(low + 1e-3, high - 1e-3, (200, 3)), 1e-5
    dist, slopes, known = read_off(tuple(map(jnp.asarray, points.T)), InArrays(row), layout)
    assert known.all()
    np.testing.assert_allclose(dist, expected(points), atol=1e-5)
    inside = np.all(np.abs(points / SPACING - np.round(points / SPACING)) > 1e-3, axis=1)
    for slope, way in zip(slopes, np.eye(3), strict=True):
        rise = SPACING * (expected(points + e * way) - expected(points - e * way)) / (2 * e)
        np.testing.assert_allclose(np.asarray(slope)[inside], rise[inside], atol=1e-4)
    beyond = tuple(map(jnp.asarray, np.concatenate([[low - 0.01], [high + 0.01]]).T))
    assert not read_off(beyond, InArrays(row), layout)[2].any()


def run_of(links: Links | None, beam: Capsules = NOTHING, grid: Grid | None = None) -> Callable:
    """A physics step of a strip of cloth that lies over the capsule."""
    spec = build_cloth(sheet(LONG, 0.025, 0.025, "corner"), GOWN_FABRIC)

    def run(cloth: Cloth) -> tuple[Cloth, ClothContact]:
        at = cloth.pos_w[jnp.asarray(spec.garment.anchors)]
        return step(spec, cloth, beam, beam, at, at, DT, jnp.bool_(False), None, grid, links)

    return run


def falling(speed: float = 0.1) -> Cloth:
    """A strip 2.5 cm above the crest of the capsule, where AG's margin already holds it."""
    v = sheet(LONG, 0.025, 0.025, "corner").vertices
    level = np.stack([v[:, 0], v[:, 2] - v[:, 2].mean(), np.full(len(v), 0.025)], -1)
    pos = jnp.asarray(level, jnp.float32)
    return Cloth(pos, jnp.zeros_like(pos).at[:, 2].set(-speed))


def still(on: float = 1.0) -> Links:
    """The capsule below the strip, at rest."""
    there = frame((LONG / 2, 0.0, -RADIUS))
    return Links(there, there, jnp.float32(on), CAPSULE)


def test_a_shape_of_the_robot_stops_cloth_as_a_capsule_found_by_the_grid_does():
    beam = Capsules(
        jnp.array([[0.0, 0.0, -RADIUS]]), jnp.array([[LONG, 0.0, -RADIUS]]), jnp.array([RADIUS])
    )
    grid = Grid(jnp.asarray(ALONG_X)[None], jnp.float32(1), (0,))
    expected, pressed = jax.jit(run_of(None, beam, grid))(falling())
    cloth, touch = jax.jit(run_of(still()))(falling())
    free, _ = jax.jit(run_of(None))(falling())
    np.testing.assert_allclose(cloth.pos_w, expected.pos_w, atol=1e-6)
    np.testing.assert_allclose(cloth.vel_w, expected.vel_w, atol=1e-4)
    assert pressed.total.sum() > 0 and touch.total.shape == (0,)  # nobody is pressed by that
    assert (cloth.pos_w - free.pos_w)[:, 2].max() > 5e-4
    off, _ = jax.jit(run_of(still(on=0.0)))(falling())
    np.testing.assert_array_equal(off.pos_w, free.pos_w)


def test_a_shape_that_rises_lifts_the_cloth_and_friction_carries_it_along():
    low, high = frame((LONG / 2, 0.0, -RADIUS)), frame((LONG / 2, 0.005, 0.015 - RADIUS))
    lifted, _ = jax.jit(run_of(Links(low, high, jnp.float32(1), CAPSULE)))(falling(0.0))
    moved = np.asarray(lifted.pos_w - falling().pos_w)
    middle = np.abs(falling().pos_w[:, 0] - LONG / 2) < 0.03
    assert moved[middle, 2].mean() > 0.01 and moved[middle, 1].mean() > 5e-4


def test_kernel_equals_xla_with_links(monkeypatch: pytest.MonkeyPatch):
    low, high = frame((0.09, 0.004, -RADIUS)), frame((0.1, 0.0, 0.005 - RADIUS))
    links = Links(low, high, jnp.float32(1), CAPSULE)
    beam = Capsules(jnp.array([[0.0, 0.0, -9.0]]), jnp.array([[0.1, 0.0, -9.0]]), jnp.array([0.1]))
    expected = jax.jit(run_of(links, beam))(falling())
    monkeypatch.setattr(fabrics, "advance", partial(kernel, interpret=True))
    made = jax.jit(run_of(links, beam))(falling())
    np.testing.assert_allclose(made[0].pos_w, expected[0].pos_w, atol=2e-6)
    assert (expected[0].pos_w - falling().pos_w)[:, 2].max() > 1e-3


def test_a_limb_is_not_pressed_by_what_a_link_does():
    low = -RADIUS - 0.011  # just in reach
    beam = Capsules(jnp.array([[0.0, 0.0, low]]), jnp.array([[LONG, 0.0, low]]), jnp.array([RADIUS]))  # fmt: skip
    alone = jax.jit(run_of(None, beam))(falling())[1]
    higher = frame((LONG / 2, 0.0, 0.01 - RADIUS))
    links = Links(higher, higher, jnp.float32(1), CAPSULE)
    behind = jax.jit(run_of(links, beam))(falling())[1]
    assert alone.total[0] > 0.01 and 0.0 < behind.total[0] < 0.7 * alone.total[0]


def lopsided() -> LinkGrids:
    """A shape without symmetry, turned and moved in its link."""
    rng = np.random.default_rng(1)
    slope, distances = np.array([0.5, -0.2, 0.8]), np.zeros((3, 3, 3))
    for i in np.ndindex(3, 3, 3):
        distances[i] = SPACING * (slope @ (np.array(i) - 1)) + rng.uniform(-0.02, 0.02)
    turn = Rotation.from_euler("xyz", [0.4, -0.9, 1.3]).as_matrix()
    return LinkGrids(
        np.array([1]), np.float32([[0.1, -0.2, 0.05]]), turn[None].astype(np.float32),
        (Layout((-1, -1, -1), (3, 3, 3), 0),), distances.astype(np.float32).ravel(),
    )  # fmt: skip


def test_grids_turn_with_their_links():
    shape = lopsided()
    turns = Rotation.from_euler("zyx", [[0.3, 0.2, 0.1], [1.0, -0.7, 0.5]])
    pos = np.float32([[[9.0, 9.0, 9.0], [1.0, 2.0, 3.0]]])
    found = shape.frames(jnp.asarray(pos), jnp.asarray(turns.as_matrix()[None], jnp.float32))
    point = np.array([0.03, 0.11, -0.07])  # in the frame of the grid
    in_link = shape.pos[0] + shape.rot[0] @ point
    origin, axes = found[0, 0, :3], np.asarray(found[0, 0, 3:]).reshape(3, 3)
    world = pos[0, 1] + turns[1].apply(in_link)
    np.testing.assert_allclose(origin + point @ axes, world, atol=1e-5)


def test_normals_point_up_the_distance_and_surfaces_move_with_their_links():
    shape, e = lopsided(), 1e-3
    turns = Rotation.from_euler("zyx", [[0.3, 0.2, 0.1], [0.32, 0.17, 0.12]])
    pos = np.float32([[0.0, 0.0, 0.0], [0.004, -0.002, 0.003]])
    rot = jnp.asarray(turns.as_matrix(), jnp.float32)[:, None]
    both = [jnp.asarray(np.stack([x, x], 1)) for x in (pos, rot[:, 0])]
    start, end = shape.frames(*both)
    links, none = Links(start, end, jnp.float32(1), shape), jnp.zeros((1, 3))
    path = trajectory(1, NOTHING, NOTHING, none, none, None, links)
    now = jax.tree.map(lambda x: InArrays(x[0]), path)
    solids = Solids(0, (), 0.04, None, shape.layouts)

    def at(points: np.ndarray) -> tuple:
        return nearest(tuple(jnp.asarray(points.T, jnp.float32)), now, solids)

    local = np.random.default_rng(0).uniform(0.05, 0.2, (20, 3))
    world = np.asarray(end[0, :3]) + local @ np.asarray(end[0, 3:]).reshape(3, 3)
    which, _, normal, carried = at(world)
    assert (which == 1).all()  # the floor would be 0
    slope = [(at(world + s)[1] - at(world - s)[1]) / (2 * e) for s in e * np.eye(3)]
    slope = np.stack(slope, -1)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(np.stack(normal, -1), slope, atol=2e-3)
    before = np.asarray(start[0, :3]) + local @ np.asarray(start[0, 3:]).reshape(3, 3)
    np.testing.assert_allclose(np.stack(carried, -1), world - before, atol=1e-5)


def test_a_link_that_is_not_finite_marks_the_cloth_as_broken():
    there = frame((LONG / 2, 0.0, -RADIUS))
    lost = Links(there, there.at[0, 4].set(jnp.nan), jnp.float32(1), CAPSULE)
    assert jax.jit(run_of(lost))(falling())[1].broken
    assert not jax.jit(run_of(replace(lost, meets=jnp.float32(0))))(falling())[1].broken


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda x: x.name)
def test_recorded_shapes_belong_to_links_that_the_arm_moves(robot: RobotSpec):
    scene = build_scene(DRESSING, robot)
    with np.load(asset_path(LINKS)) as kept:
        recorded = kept["link"][kept["robot"] == robot.name].tolist()
    links = scene.index.robot_links
    assert set(recorded) <= set(links)
    grids = link_grids(robot.name, links)
    assert [links[row] for row in grids.rows] == recorded
    for layout in grids.layouts:
        stop = layout.offset + int(np.prod(layout.points))
        found = grids.distances[layout.offset : stop].reshape(layout.points)
        assert np.isfinite(found).all()
        for axis in range(3):  # a distance cannot change faster than the place
            assert np.abs(np.diff(found, axis=axis)).max() < SPACING + 0.002
    square = grids.rot @ grids.rot.swapaxes(1, 2)
    np.testing.assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), atol=1e-5)
    data = mujoco.MjData(scene.model)
    data.qpos[:] += np.linspace(0.1, 0.4, scene.model.nq)
    mujoco.mj_kinematics(scene.model, data)
    arm = motion_at_rest(scene.index, data, 2).robot
    assert arm is not None and (arm.robot, arm.names) == (robot.name, links)
    for name, pos, rot in zip(links, arm.pos_w[-1], arm.rot_w[-1], strict=True):
        body = data.body(f"robot/{name}")
        np.testing.assert_allclose(pos, body.xpos, atol=1e-6)
        np.testing.assert_allclose(rot.ravel(), body.xmat, atol=1e-6)


def test_what_is_not_known_is_named():
    with pytest.raises(
        SpecError, match=r"Baxter, Jaco, PR2, Sawyer .*nothing was recorded of R2D2"
    ):
        link_grids("R2D2", ("arm",))
    with pytest.raises(
        SpecError, match=r"links of Jaco: j2s7s300_link_1, .* none of them, but: arm"
    ):
        link_grids("Jaco", ("arm",))


def test_a_physics_step_with_links_is_one_kernel_on_a_gpu():
    many = jax.tree.map(lambda x: jnp.stack([x, x]), falling())
    beam = run_of(still(), Capsules(jnp.zeros((1, 3)), jnp.ones((1, 3)), jnp.ones(1)))
    lowered = jax.jit(jax.vmap(beam)).trace(many).lower(lowering_platforms=("cuda",))
    assert lowered.as_text().count("__gpu$xla.gpu.triton") == 1
