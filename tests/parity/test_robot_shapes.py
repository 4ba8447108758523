# ruff: noqa: D103 (a test's name says what it shows)
"""The shapes of Baxter and Sawyer beside Assistive Gym's."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity.shapes import AG, Shape, farthest, gripper, ours, rows

BALL = Shape("sphere", (0.02,), (0.1, 0.0, 0.0))
POINTS = np.array([[0.1, 0.0, 0.0], [0.15, 0.0, 0.0], [0.1, 0.03, 0.04]])


def test_differences_hold_or_name_a_deviation():
    assert_rows_hold_or_name_a_deviation(rows())


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (BALL, [0.0, 0.03, 0.03]),
        (Shape("capsule", (0.02, 0.03), (0.1, 0.0, 0.0)), [0.0, 0.03, np.hypot(0.03, 0.01) - 0.02]),
        (Shape("cylinder", (0.02, 0.03), (0.1, 0.0, 0.0)), [0.0, 0.03, np.hypot(0.01, 0.01)]),
        (Shape("box", (0.01, 0.02, 0.03), (0.1, 0.0, 0.0)), [0.0, 0.04, np.hypot(0.01, 0.01)]),
    ],
)
def test_distance_of_a_point_from_a_solid(shape, expected):
    np.testing.assert_allclose(shape.outside(POINTS), expected, atol=1e-9)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.6, 0.8)])
@pytest.mark.parametrize(
    ("kind", "size"), [("cylinder", (0.02, 0.03)), ("capsule", (0.02, 0.03)), ("sphere", (0.02,))]
)
def test_a_surface_lies_on_its_solid_and_reaches_its_ends(kind, size, axis):
    shape = Shape(kind, size, (0.3, -0.2, 0.1), axis)
    points = shape.surface()
    assert shape.outside(points).max() < 1e-9
    along = (points - np.array(shape.pos)) @ np.array(axis)
    ends = size[0] if kind == "sphere" else size[1] + (size[0] if kind == "capsule" else 0.0)
    assert along.max() == pytest.approx(ends, abs=1e-9) == -along.min()


def test_a_cylinders_rims_are_outside_the_capsule_of_its_length():
    cylinder, capsule = Shape("cylinder", (0.06, 0.0825)), Shape("capsule", (0.06, 0.0225))
    assert farthest([cylinder], [capsule]) == pytest.approx(60 * (np.sqrt(2) - 1))
    assert farthest([capsule], [cylinder]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("robot", AG)
def test_each_link_has_shapes_here(robot):
    assert all(ours(robot, link) for link in AG[robot])


def test_open_fingers_are_as_much_wider_as_each_is_moved():
    closed, opened = (np.concatenate([x.surface() for x in gripper(o)[1::3]]) for o in (0.0, 0.02))
    assert np.ptp(opened[:, 1]) - np.ptp(closed[:, 1]) == pytest.approx(0.04)
    np.testing.assert_allclose(np.ptp(opened, axis=0)[[0, 2]], np.ptp(closed, axis=0)[[0, 2]])
