# ruff: noqa: D103
"""Food and water in a tool that is carried as Assistive Gym's was."""

from __future__ import annotations

import numpy as np
import pytest

from agym_jax.tasks import TASKS
from benchmarks.parity import matter
from benchmarks.parity.row import traces


@pytest.mark.jit
@pytest.mark.parametrize(("name", "count"), [("Feeding", 8), ("Drinking", 64)])
def test_what_was_recorded_at_rest_stays(name: str, count: int):
    t = traces("matter")
    key = name.lower()
    still = np.tile(t[f"{key}_tilt0_tool"][0], (4, 1))
    left = matter.left(TASKS[name], matter.VESSELS[name], still, t[f"{key}_start"][0])
    assert (left == count).all()


def test_turns_that_end_early_have_no_angle():
    assert matter._first(np.array([0.0, 30.0, 60.0]), np.array([False, True, True])) == 30.0
    assert matter._first(np.array([0.0, 30.0, 60.0]), np.zeros(3, bool)) == 60.0
