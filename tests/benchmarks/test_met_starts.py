# ruff: noqa: D103
"""Episodes that would begin inside the person: found, and none of them does any more. C MuJoCo."""

from __future__ import annotations

import pytest

from benchmarks import met_starts
from benchmarks.met_starts import MetStartsConfig


@pytest.mark.jit
def test_episodes_that_would_begin_inside_somebody_are_found_and_do_not():
    config = MetStartsConfig(impl="native", num_draws=8192, num_steps=2)
    found = met_starts.measure(config)
    assert found["draws"] == 8192 and 5 < found["starts"] < 40
    assert found["before/rough"] > 0 and found["before/peak"] > 300.0
    assert found["now/rough"] == found["now/nan"] == 0 and found["now/peak"] < 100.0


def test_a_task_in_which_nobody_lies_is_refused(capsys):
    assert met_starts.main(["--env-name", "ReachingJaco-v0", "--impl", "native"]) == 2
    assert "there is no table of whom its placements meet" in capsys.readouterr().err
