# ruff: noqa: D103 (a test's name says what it shows)
"""Interquartile mean, bootstrap intervals and probability of improvement, against cases with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from train.evaluation.statistics import (
    bootstrap_interval,
    improvement_interval,
    iqm,
    probability_of_improvement,
)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert iqm([1, 2, 3, 4, 5, 6, 7, 80]) == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert iqm([-100, 1, 3, 100]) == 2
    # 5 scores: a quarter is 1.25 scores, so the second and the fourth count by three quarters
    assert iqm([0, 1, 2, 3, 9]) == pytest.approx((0.75 * 1 + 2 + 0.75 * 3) / 2.5)
    assert iqm([7.0]) == 7 and iqm([1, 2]) == 1.5
    np.testing.assert_allclose(iqm(np.array([[4, 3, 2, 1], [1, 1, 1, 1]])), [2.5, 1])
    np.testing.assert_allclose(iqm(np.eye(4), axis=0), 0.0)
    with pytest.raises(ValueError, match="at least one"):
        iqm([])


def test_the_interval_of_equal_seeds_is_a_point_and_of_others_contains_their_mean():
    assert bootstrap_interval(np.full((8, 1), 0.5)) == (0.5, 0.5)
    scores = np.random.default_rng(0).normal(3.0, 1.0, (40, 1))
    low, high = bootstrap_interval(scores, lambda x: x.mean(-1))
    half = 1.96 * scores.std() / np.sqrt(40)  # of the mean, by the normal distribution
    assert low == pytest.approx(scores.mean() - half, abs=0.05)
    assert high == pytest.approx(scores.mean() + half, abs=0.05)


def test_episodes_are_drawn_anew_within_each_seed():
    # all seeds have the same mean, so that only the draws of episodes make the interval wide
    scores = np.tile([0.0, 1.0], (8, 50))
    low, high = bootstrap_interval(scores, lambda x: x.mean(-1))
    assert 0.5 - low == pytest.approx(1.96 * 0.5 / np.sqrt(800), rel=0.15)
    assert high - 0.5 == pytest.approx(0.5 - low, rel=0.2)


def test_the_interval_covers_what_it_should():
    rng, hits = np.random.default_rng(1), 0
    for trial in range(200):
        scores = rng.normal(0.0, 1.0, (16, 1))
        low, high = bootstrap_interval(scores, lambda x: x.mean(-1), resamples=400, seed=trial)
        hits += low <= 0.0 <= high
    assert 170 <= hits <= 198  # 95 % nominally; the bootstrap of 16 gives 91 to 95 %


def test_probability_of_improvement():
    assert probability_of_improvement([2, 3], [0, 1]) == 1
    assert probability_of_improvement([0, 1], [2, 3]) == 0
    assert probability_of_improvement([1, 1], [1, 1, 1]) == 0.5
    assert probability_of_improvement([1, 3], [2, 2]) == 0.5
    assert probability_of_improvement([1, 2, 3], [2]) == pytest.approx((0 + 0.5 + 1) / 3)
    low, high = improvement_interval(np.arange(8), np.arange(8))
    assert low < 0.5 < high and low > 0.1 and high < 0.9
    assert improvement_interval([5, 6, 7], [1, 2, 3]) == (1.0, 1.0)
