# ruff: noqa: D103 (a test's name says what it shows)
"""What makes contact rough, from hand-made forces."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import rough

COMFORT = np.array([10.0, 20.0])


def forces(*episodes):
    """Episodes of steps of two regions (T, B, 2)."""
    return np.stack([np.array(x, float) for x in episodes], axis=1)


def test_a_first_touch_is_told_from_pressing():
    peak = forces(
        [(0, 30), (0, 25), (0, 0), (0, 40)],  # hits, presses on, leaves and hits again
        [(5, 0), (15, 0), (0, 0), (0, 0)],  # touches gently, then presses
        [(9, 19), (9, 19), (9, 19), (9, 19)],  # within the limits
        [(0, 0), (0, 21), (0, 5), (0, 0)],  # hits, and fails
    )
    success = np.array([True, True, True, False])
    found = rough.summary(peak, peak / 2, COMFORT, success)
    assert found["rough_steps"] == 5 / 4
    assert found["first_touch"] == pytest.approx(3 / 5)
    assert found["mean_below"] == pytest.approx(5 / 5)
    assert found["gentle"] == 1 / 4 and found["gentle_but_first_touches"] == 1 / 4
    assert (found["first_touch_n"], found["pressing_n"]) == (30.0, 20.0)
    assert found["regions"] == {rough.NAMES[0]: 0.2, rough.NAMES[1]: 0.8}


def test_episodes_that_only_hit_are_gentle_but_for_that():
    peak = forces([(0, 30), (0, 5)], [(0, 5), (0, 30)])
    found = rough.summary(peak, peak, COMFORT, np.array([True, True]))
    assert found["gentle"] == 0.0 and found["gentle_but_first_touches"] == 0.5
    assert found["mean_below"] == 0.0


def test_nothing_rough_is_no_division_by_zero():
    found = rough.summary(forces([(1, 1)]), forces([(1, 1)]), COMFORT, np.array([True]))
    assert found["rough_steps"] == found["first_touch"] == 0.0 and found["gentle"] == 1.0
    assert found["first_touch_n"] is None and found["regions"] == {}


def test_an_unknown_id_says_what_exists(capsys):
    assert rough.main(["ScratchItchJacko-v0"]) == 2
    assert "ScratchItchJaco-v0" in capsys.readouterr().err
