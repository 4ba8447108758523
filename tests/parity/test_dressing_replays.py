# ruff: noqa: D103
"""A path that dresses in Assistive Gym, and one that does not; shares over all recorded ones are in the parity page."""

from __future__ import annotations

import jax
import pytest

from benchmarks.parity import dressing
from benchmarks.parity.row import traces


@pytest.mark.slow
@pytest.mark.parity
def test_a_path_of_pr2_puts_the_sleeve_on_and_one_of_jaco_does_not():
    best, there = {}, {}
    for robot in ("PR2", "Jaco"):
        case = dressing.cases(robot)[1]
        best[robot] = dressing.play(dressing.env_of(robot, True), case, jax.random.PRNGKey(0))
        there[robot] = traces("dressing")["dressed"][case]
    assert best["PR2"] > 0.4 and there["PR2"] > 0.4
    assert best["Jaco"] < 0.1 and there["Jaco"] < 0.1
