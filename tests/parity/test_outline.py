# ruff: noqa: D103
"""PR2's forearm and hand reach as far as Assistive Gym's."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity import outline


def test_rows_hold_or_name_a_deviation():
    assert_rows_hold_or_name_a_deviation(outline.rows())


@pytest.mark.parametrize("part", outline.PARTS)
def test_both_arms_reach_alike_and_nowhere_far_from_assistive_gyms(part: str):
    left, right = outline.apart(part, "l"), outline.apart(part, "r")
    np.testing.assert_allclose(left, right, atol=1e-3)
    assert np.sqrt(np.mean(left**2)) < 5.0
    # hemispheres beside what ends flat: 21 mm with one capsule for the forearm
    assert abs(left).max() < 15.0
