# ruff: noqa: D103
"""The nightstand is where Assistive Gym's is, for the robot's arm and for the person's."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity import beside_bed
from benchmarks.parity.row import traces


def test_rows_hold_or_name_a_deviation():
    assert_rows_hold_or_name_a_deviation(beside_bed.rows())


def test_jacos_third_link_lies_on_the_edge_where_it_does_in_assistive_gym():
    ours, ag = beside_bed.robot_distances()
    lies = np.abs(ag) < 0.001
    assert lies.sum() > 10
    # with the link's other capsule, 7 mm thinner, 7 mm
    assert np.abs(np.median(ours[lies])) < 0.003 and ours[lies].max() < 0.003


def test_a_hanging_arm_meets_the_nightstand_where_it_does_in_assistive_gym():
    ours, ag = beside_bed.person_distances()
    # with the box that the robot meets, 23 mm
    assert np.abs(np.median(ours - ag)) < 0.004 and np.abs(ours - ag).max() < 0.01


@pytest.mark.parametrize("strength", [12.0, 20.0])
def test_a_limp_arm_withstands_the_pushes_that_it_withstands_in_assistive_gym(strength: float):
    kept = traces("beside_bed")
    pushed = kept["push_force"] == strength
    ours, ag = (np.median(x[pushed, -1]) for x in (beside_bed.moved(), kept["push_moved"]))
    assert abs(ours - ag) < 0.01  # with a rolling friction of 0.15 m, 4 and 20 cm apart


def test_a_harder_push_moves_the_limp_arm_farther():
    force = traces("beside_bed")["push_force"]
    for moved in (beside_bed.moved(), traces("beside_bed")["push_moved"]):
        far = [np.median(moved[force == x, -1]) for x in (12.0, 20.0, 30.0)]
        assert 0.0 < far[0] < far[1] < far[2] < 0.5
