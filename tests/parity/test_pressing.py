# ruff: noqa: D103
"""A tool presses on the person as hard as in Assistive Gym. C MuJoCo, a third of the recorded cases."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.deviations import collect
from benchmarks.parity import pressing


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("name", pressing.TASKS)
def test_slow_presses_have_assistive_gyms_force(name: str):
    levels = pressing.traces("pressing")[f"{name}_case"][:, 1]
    slow = np.flatnonzero(np.isclose(levels, levels.min(), atol=0.01))[::2]
    theirs, ours = pressing.recorded(name, slow), pressing.press(name, slow)
    last = [x.force[:, -pressing.LAST :].mean() for x in (theirs, ours)]
    np.testing.assert_allclose(last[1], last[0], rtol=0.25)
    assert last[0] > 2.0  # it is about contact
    assert 0.0 <= np.nanmedian(ours.depth) < 1e-3  # and as good as rigid
    assert ours.force.max() < 1.5 * theirs.force.max()


def test_forces_that_differ_name_a_deviation():
    assert "rigid-grip" in {note.slug for note in collect()}
