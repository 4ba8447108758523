# ruff: noqa: D103
"""The wiper meets limbs as Assistive Gym's does. C MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from parity_rows import assert_rows_hold_or_name_a_deviation

from benchmarks.parity import wiper


@pytest.fixture(scope="module")
def rows() -> list[wiper.Row]:
    return wiper.rows()


def test_rows_hold_or_name_a_deviation(rows: list[wiper.Row]):
    assert len(rows) == 7
    assert_rows_hold_or_name_a_deviation(rows)


def test_pad_and_plate_change_over_at_assistive_gyms_angles(rows: list[wiper.Row]):
    by_name = {row.quantity: row for row in rows}
    assert by_name["orientations, of 648, in which another part bears it"].ours <= 6
    assert by_name["distance between both contacts of the pad, median"].ours < 0.5


@pytest.mark.parametrize(("pitch", "roll", "pad"), [(0, 0, True), (0, 30, True), (20, 0, False)])
def test_pad_bears_until_the_wiper_is_tilted_along_its_length(pitch: int, roll: int, pad: bool):
    """A woman's forearm is nearly level: the plate's ends stand 5 mm above the pad, 25 mm outside of it."""
    touch = wiper.press("female", 7, 0)
    i, j = (int(np.argmin(np.abs(wiper.ANGLES - np.deg2rad(x)))) for x in (pitch, roll))
    assert touch.pad_bears[i, j] == touch.pad_bears[i, 8 - j] == pad


def test_points_within_reach_are_counted():
    radius, spacing = 0.027, 0.03
    on_ring = np.array([[0.0, -radius, -0.234 / 8]])
    assert wiper.wiped("female", 7, on_ring)[0] == 1  # its neighbours are 3 cm away
    between = np.array([[-radius * np.sin(a), -radius * np.cos(a), -0.234 / 8] for a in [spacing / 2 / radius]])  # fmt: skip
    assert wiper.wiped("female", 7, between)[0] == 2
    assert wiper.wiped("female", 7, np.full((1, 3), np.nan))[0] == 0
