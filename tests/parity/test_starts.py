# ruff: noqa: D103
"""Episodes begin where Assistive Gym's begin. C MuJoCo and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from agym_jax.math3d import first_sign
from benchmarks.parity import starts
from benchmarks.parity.row import traces


@pytest.fixture(scope="module")
def rows() -> list[starts.Row]:
    return starts.rows()


@pytest.mark.slow
def test_rows_hold_or_name_a_deviation(rows: list[starts.Row]):
    assert len(rows) > 150
    assert_rows_hold_or_name_a_deviation(rows)
    assert np.mean([row.holds for row in rows]) > 0.85


@pytest.mark.slow
def test_same_rest_pose_gives_the_same_arm(rows: list[starts.Row]):
    replayed = [row for row in rows if "replayed" in row.quantity]
    assert len(replayed) == len(starts.REPLAYED) and all(row.holds for row in replayed)


@pytest.mark.slow
def test_jacos_families_and_joints_are_assistive_gyms(rows: list[starts.Row]):
    """40 resets each, 37 of ArmManipulation and 19 of Dressing: enough to see proportions."""
    for row in rows:
        if "Jaco" in row.quantity and ("family" in row.quantity or "Kuiper" in row.quantity):
            assert row.holds, row


def test_recorded_quaternions_have_the_sign_that_ours_begin_with():
    quats = [v.reshape(-1, 4) for k, v in traces("starts").items() if k.endswith("_quats")]
    found = np.concatenate(quats)
    assert len(found) > 600
    np.testing.assert_array_equal(found, first_sign(found))


def test_kuipers_distance_does_not_mind_where_the_circle_is_cut():
    rng = np.random.default_rng(0)
    a, b = rng.normal(3.0, 0.5, 300), rng.normal(3.0, 0.5, 300)
    near = starts.kuiper(starts.wrap(a), starts.wrap(b))
    np.testing.assert_allclose(
        near, starts.kuiper(starts.wrap(a + 2), starts.wrap(b + 2)), atol=0.01
    )
    assert near < 0.2 < 0.7 < starts.kuiper(starts.wrap(a), starts.wrap(b + 1.5))


def test_families_are_counted():
    rng = np.random.default_rng(1)
    one, other = rng.normal(0.0, 0.1, (60, 7)), rng.normal(np.pi, 0.1, (20, 7))
    both = np.concatenate([one, other])
    middles = starts.families(both)
    assert len(middles) == 2
    np.testing.assert_allclose(starts.shares(both, middles), [0.75, 0.25, 0.0])
    np.testing.assert_allclose(starts.shares(other, middles), [0.0, 1.0, 0.0])
