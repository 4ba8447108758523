# ruff: noqa: D103
"""Paths of the hand that put the gown on in Assistive Gym do so here, and others miss it. C MuJoCo."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import agym_jax
from benchmarks.parity import gown


@pytest.mark.slow
def test_a_low_slow_path_puts_the_sleeve_on_and_a_high_fast_one_misses():
    env, kept = agym_jax.make("DressingJaco-v0", impl="native"), gown.traces("gown")
    number, best = gown.play(env, 0, jax.random.PRNGKey(0))
    assert abs(best - kept["best"][0]) < gown.NEAR
    ag = kept["number"][0, gown.ON_HAND :].mean()
    np.testing.assert_allclose(number[gown.ON_HAND :].mean(), ag, rtol=0.4)
    assert gown.play(env, 3, jax.random.PRNGKey(0))[1] < 0.1
