# ruff: noqa: D103
"""Where Assistive Gym's gown touched Jaco, against the distances and frames of Jaco's shapes here."""

from __future__ import annotations

import numpy as np
import pytest

from agym_jax.matter.cloth.grid import MARGIN
from benchmarks.parity.robot_arm import distances

pytestmark = pytest.mark.parity


def test_the_recorded_gown_lies_at_the_margin_of_the_shapes_and_not_elsewhere():
    def near_margin(shift: float) -> float:
        off = distances(shift) - MARGIN
        return float(np.mean((off > -0.005) & (off < 0.001)))

    assert near_margin(0.0) > 0.4  # others lie on the person, or fall into what they touch
    assert max(near_margin(0.05), near_margin(-0.05)) < 0.06
