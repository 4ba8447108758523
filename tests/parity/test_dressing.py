# ruff: noqa: D103
"""Recorded actions dress here whom they dressed in Assistive Gym; all of them are in the parity page."""

from __future__ import annotations

import jax
import pytest

from benchmarks.parity import dressing
from benchmarks.parity.row import traces


@pytest.mark.slow
@pytest.mark.parity
@pytest.mark.parametrize(("robot", "case"), [("PR2", 1), ("Jaco", 1)])
def test_a_sleeve_goes_on_where_it_did_in_assistive_gym(robot: str, case: int):
    row, env = dressing.cases(robot)[case], dressing.env_of(robot, True)
    best = dressing.play(env, row, jax.random.PRNGKey(0))
    on = traces("dressing")["dressed"][row] > dressing.UP_THE_ARM
    assert on == (robot == "PR2")
    assert (best > dressing.UP_THE_ARM) == on
